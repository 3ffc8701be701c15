"""Multiple shooting: the states at the beginning of short segments are unknowns, continuity is a constraint."""

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from greybox.compiled.sample_step import SampleStep
from greybox.compiled.sampled_data import Experiment
from greybox.compiled.transcription.method import Transcribed, Transcription


@dataclass(frozen=True)
class MultipleShooting(Transcription):
    """Segments of a few samples, Gauss-Newton steps with their nodes eliminated; the default method.

    Source: Bock, Kostina, Schlöder (2007), Numerical methods for parameter estimation in nonlinear differential
    algebraic equations, GAMM-Mitteilungen 30.

    Parameters
    ----------
    segment, integrator, hessian
        See `Transcription`; the "exact" Hessian goes with IPOPT.
    ipopt : bool
        Solve one sparse problem by IPOPT instead.
    compile : bool
        Translate the linearization to C once and keep it; needs a C compiler.
    """

    ipopt: bool = False
    compile: bool = False  # type: ignore[misc]
    label: ClassVar[str] = "multiple shooting"

    @property
    def by_ipopt(self) -> bool:
        """True when IPOPT solves the whole problem."""
        return self.ipopt or self.hessian == "exact"

    def transcribe(self, step: SampleStep, experiment: Experiment, q: ca.MX, data: Any) -> Transcribed:
        """Return the nodes, and the gaps between ends and next nodes."""
        n, length, s = step.function.size1_in(0), experiment.segment, experiment.segments
        x, Q = ca.MX.sym("x", n), ca.MX.sym("q", q.numel())
        d = ca.MX.sym("d", step.width, length)
        end, residuals = _follow(step, x, Q, d, length)
        segment = ca.Function("segment", [x, Q, d], [end, residuals]).map("segments", "serial", s, [1], [])
        nodes = ca.MX.sym("nodes", n, s)
        ends, found = segment(nodes, q, data)
        before = np.flatnonzero(experiment.coupled)
        gaps = ends[:, before.tolist()] - nodes[:, (before + 1).tolist()]
        return Transcribed(
            unknowns=ca.vec(nodes),
            residuals=found,
            equations=ca.vec(gaps),
            initial=nodes[:, np.flatnonzero(experiment.first).tolist()],
            start=lambda states: states[:, ::length].ravel(order="F"),
        )


def _follow(step: SampleStep, x: ca.MX, q: ca.MX, d: ca.MX, length: int) -> tuple[ca.MX, ca.MX]:
    """Return the end of a segment and its residuals (k, length)."""
    after, residuals, _ = step.function.mapaccum("segment", length)(x, q, d)
    return after[:, length - 1], residuals
