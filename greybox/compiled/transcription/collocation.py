"""Direct collocation: a polynomial between samples, whose slope is the derivative at the collocation points."""

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from greybox.compiled.sample_step import SampleStep
from greybox.compiled.sampled_data import Experiment
from greybox.compiled.transcription.method import Transcribed, Transcription


@dataclass(frozen=True)
class Collocation(Transcription):
    """Radau points between every two samples: no simulation, so neither stiff nor unstable models trouble it.

    Source: Betts (2010), Practical Methods for Optimal Control and Estimation Using Nonlinear Programming, 2nd ed.,
    chapter 5; Hairer and Wanner, Solving ODEs II, IV.5.

    Parameters
    ----------
    segment, integrator, hessian
        See `Transcription`; the integrator serves the first states and the simulated outputs of the answer.
    degree : int
        Collocation points a sample, 1 to 9; the order is twice that less one.
    """

    degree: int = 3
    label: ClassVar[str] = "direct collocation"

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        if not isinstance(self.degree, int) or not 1 <= self.degree <= 9:
            raise ValueError(f"degree {self.degree!r} must be a whole number from 1 to 9.")

    def transcribe(self, step: SampleStep, experiment: Experiment, q: ca.MX, data: Any) -> Transcribed:
        """Return the states at all samples and collocation points, and the equations of every step."""
        n, samples = step.function.size1_in(0), experiment.segments * experiment.segment
        equations, residuals = self._sample(step)
        nodes, inside = ca.MX.sym("nodes", n, samples), ca.MX.sym("inside", n * self.degree, samples)
        found = residuals.map("residuals", "serial", samples, [1], [])(nodes, q, data)
        errors, end = equations.map("equations", "serial", samples, [2], [])(nodes, inside, q, data)
        ends = np.cumsum([c * experiment.segment for c in experiment.counts]) - 1
        linked = np.setdiff1d(np.arange(samples), ends)
        gaps = end[:, linked.tolist()] - nodes[:, (linked + 1).tolist()]
        first = (np.concatenate([[0], ends[:-1] + 1])).tolist()
        return Transcribed(
            unknowns=ca.vertcat(ca.vec(nodes), ca.vec(inside)),
            residuals=found,
            equations=ca.vertcat(ca.vec(errors), ca.vec(gaps)),
            initial=nodes[:, first],
            start=lambda states: np.concatenate(
                [states.ravel(order="F"), np.tile(states, (self.degree, 1)).ravel(order="F")]
            ),
        )

    def _sample(self, step: SampleStep) -> tuple[ca.Function, ca.Function]:
        """Return (x, points, q, d) -> collocation errors and end of the step, and (x, q, d) -> residuals."""
        n = step.function.size1_in(0)
        x, q, d = (ca.SX.sym(name, step.before.numel_in(k)) for k, name in enumerate("xqd"))
        points = ca.SX.sym("points", n, self.degree)
        corrected, mean, change, residual, _ = step.before(x, q, d)
        p, h = q[: len(step.system.parameters)], d[d.numel() - 1]
        tau = ca.collocation_points(self.degree, "radau")
        C, D, _ = ca.collocation_coeff(tau)
        polynomial = ca.horzcat(corrected, points)
        slopes = polynomial @ C
        errors = [
            slopes[:, k] - h * step.system.derivative(points[:, k], mean + change * (tau[k] - 0.5), p)
            for k in range(self.degree)
        ]
        end = polynomial @ D
        return (
            ca.Function("equations", [x, ca.vec(points), q, d], [ca.vertcat(*errors), end]),
            ca.Function("residuals", [x, q, d], [residual]),
        )
