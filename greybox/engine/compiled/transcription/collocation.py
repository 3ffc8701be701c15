"""Direct collocation: stages of an implicit integrator are unknowns, its equations constraints."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.argument_checks import require_whole
from greybox.data.files.public import public
from greybox.engine.compiled.sample_step import SampleStep
from greybox.engine.compiled.sampled_data import SampledData
from greybox.engine.compiled.transcription.method import Transcribed, Transcription
from greybox.modeling.implicit_integrators import ImplicitIntegrator, Radau

# What CasADi tabulates.
MOST_POINTS = 9


@public
@dataclass(frozen=True)
class Collocation(Transcription):
    """Radau points between samples: no simulation, so stiff and unstable models cause no trouble.

    Source: Betts (2010), Practical Methods for Optimal Control and Estimation Using Nonlinear
    Programming, 2nd ed., chapter 5; Hairer and Wanner, Solving ODEs II, IV.5.

    Parameters
    ----------
    segment, hessian
        See `Transcription`.
    degree : int
        Collocation points a sample, 1 to 9; the order is twice that less one.

    Examples
    --------
    >>> from greybox.models.specific_force import RotorThrust
    >>> from greybox.problems import nanobench_thrust
    >>> problem = gb.Problem(RotorThrust(), nanobench_thrust.data()[0].between(5, 10))
    >>> gb.fit(problem, starts=1, method=gb.Collocation()).converged
    True
    """

    degree: int = 3
    label = "direct collocation"

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        require_whole("degree", self.degree, 1, MOST_POINTS)

    @property
    def scheme(self) -> ImplicitIntegrator:
        """Radau IIA, one step per sample: its stages are the collocation points."""
        return Radau(substeps=1, degree=self.degree)

    def transcribe(self, step: SampleStep, data: SampledData, q: ca.MX, rows: Any) -> Transcribed:
        """Return the states at all samples and stages, and the equations of every step."""
        n = step.function.size1_in(0)
        samples = data.samples
        stages = self.scheme.stages
        nodes, inside = ca.MX.sym("nodes", n, samples), ca.MX.sym("inside", n * stages, samples)
        of_samples = self._sample(step).map("samples", "serial", samples, [2], [])
        errors, end, residuals = of_samples(nodes, inside, q, rows)
        # The last sample of a stretch continues nowhere.
        first = data.first_samples
        linked = np.setdiff1d(np.arange(samples - 1), first - 1)
        gaps = end[:, linked.tolist()] - nodes[:, (linked + 1).tolist()]

        return Transcribed(
            unknowns=ca.vertcat(ca.vec(nodes), ca.vec(inside)),
            residuals=residuals,
            equations=ca.vertcat(ca.vec(errors), ca.vec(gaps)),
            initial=nodes[:, first.tolist()],
            # Stages begin at the state of their sample.
            start=lambda states: np.concatenate(
                [states.ravel(order="F"), np.tile(states, (stages, 1)).ravel(order="F")]
            ),
        )

    def _sample(self, step: SampleStep) -> ca.Function:
        """Return (x, stages, q, d) -> equations and end of the step, and residuals."""
        n = step.function.size1_in(0)
        scheme = self.scheme
        x, q, d = step.measurement.sx_in()
        stages = ca.SX.sym("stages", n, scheme.stages)
        corrected, mean, change, residual, _ = step.measurement(x, q, d)
        p, h = q[: len(step.system.parameters)], d[d.numel() - 1]
        equations = scheme.equations(
            step.system, corrected, stages, mean - change / 2, change / h, p, h
        )
        end = scheme.end(corrected, stages)

        outputs = [ca.vec(equations), end, residual]
        return ca.Function("sample", [x, ca.vec(stages), q, d], outputs)

    def finer(self, substeps: int) -> str:
        """Return the option that integrates more accurately: more points, or several steps."""
        if self.degree == MOST_POINTS:
            return "method=MultipleShooting(), which takes several steps per sample"
        return self._option(degree=self.degree + 1)
