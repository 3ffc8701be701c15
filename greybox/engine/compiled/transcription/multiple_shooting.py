"""Multiple shooting: states at the nodes of short segments are unknowns, gaps are constraints."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.public import public
from greybox.engine.compiled.sample_step import SampleStep
from greybox.engine.compiled.sampled_data import SampledData
from greybox.engine.compiled.transcription.method import Shooting, Transcribed


@public
@dataclass(frozen=True)
class MultipleShooting(Shooting):
    """Segments of a few samples, Gauss-Newton steps, nodes eliminated; the default method.

    Source: Bock, Kostina, Schlöder (2007), Numerical methods for parameter estimation in nonlinear
    differential algebraic equations, GAMM-Mitteilungen 30.

    Parameters
    ----------
    segment, hessian
        See `Transcription`; the "exact" Hessian goes with IPOPT.
    integrator : Integrator, optional
        `RungeKutta()`, or `Radau()` for stiff models; by default as the poles along the data
        need.
    ipopt : bool
        Solve one sparse problem by IPOPT instead.

    Examples
    --------
    >>> from greybox.models.specific_force import RotorThrust
    >>> from greybox.problems import nanobench_thrust
    >>> problem = gb.Problem(RotorThrust(), nanobench_thrust.data()[0].between(5, 10))
    >>> fits = [gb.fit(problem, 1, method=gb.MultipleShooting(segment=k)) for k in (5, 20)]
    >>> abs(fits[0].cost - fits[1].cost) < 1e-3
    True
    """

    ipopt: bool = False
    label = "multiple shooting"

    @property
    def by_ipopt(self) -> bool:
        """True when IPOPT solves the whole problem."""
        return self.ipopt or self.hessian == "exact"

    def transcribe(self, step: SampleStep, data: SampledData, q: ca.MX, rows: Any) -> Transcribed:
        """Return the nodes, and the gaps between ends and next nodes."""
        n = step.function.size1_in(0)
        length = data.segment_length
        s = data.segments
        x, Q, D = ca.MX.sym("x", n), ca.MX.sym("q", q.numel()), ca.MX.sym("D", step.width, length)
        states, errors = step.folded(length)(x, Q, D)
        segment = ca.Function("segment", [x, Q, D], [states[:, length - 1], errors])
        nodes = ca.MX.sym("nodes", n, s)
        ends, residuals = segment.map("segments", "serial", s, [1], [])(nodes, q, rows)
        # The last segment of a stretch continues nowhere.
        linked = np.flatnonzero(data.coupled)
        gaps = ends[:, linked.tolist()] - nodes[:, (linked + 1).tolist()]

        return Transcribed(
            unknowns=ca.vec(nodes),
            residuals=residuals,
            equations=ca.vec(gaps),
            initial=nodes[:, np.flatnonzero(data.begins_stretch).tolist()],
            start=lambda states: states[:, ::length].ravel(order="F"),
        )
