"""Single shooting: only the initial states are unknown, everything else is simulated from them."""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from greybox.data.files.public import public
from greybox.engine.compiled.sample_step import SampleStep
from greybox.engine.compiled.sampled_data import SampledData
from greybox.engine.compiled.transcription.method import Shooting, Transcribed


@public
@dataclass(frozen=True)
class SingleShooting(Shooting):
    """Simulation from the first sample: few unknowns, but not for an unstable plant.

    Source: Schittkowski (2002), Numerical Data Fitting in Dynamical Systems, chapter 4.

    Parameters
    ----------
    segment, hessian
        See `Transcription`.
    integrator : Integrator, optional
        `RungeKutta()`, or `Radau()` for stiff models; by default as the poles along the data
        need.

    Examples
    --------
    >>> from greybox.models.specific_force import RotorThrust
    >>> from greybox.problems import nanobench_thrust
    >>> problem = gb.Problem(RotorThrust(), nanobench_thrust.data()[0].between(5, 10))
    >>> gb.fit(problem, starts=1, method=gb.SingleShooting()).converged
    True
    """

    label = "single shooting"

    def transcribe(self, step: SampleStep, data: SampledData, q: ca.MX, rows: Any) -> Transcribed:
        """Return the initial states; there are no equations."""
        starts = data.first_samples.tolist()
        initial = ca.MX.sym("initial", step.function.size1_in(0), len(starts))
        stretches = ca.horzsplit(rows, [*starts, data.samples])
        residuals = [
            step.folded(stretch.shape[1])(x, q, stretch)[1]
            for x, stretch in zip(ca.horzsplit(initial), stretches, strict=True)
        ]
        return Transcribed(
            unknowns=ca.vec(initial),
            residuals=ca.horzcat(*residuals),
            equations=ca.MX(0, 1),
            initial=initial,
            start=lambda states: states[:, starts].ravel(order="F"),
        )
