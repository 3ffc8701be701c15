"""Multiple shooting: the states at the beginning of short segments are unknowns, continuity is a constraint."""

from dataclasses import dataclass, field

from greybox.integrator import Integrator, RungeKutta


@dataclass(frozen=True)
class MultipleShooting:
    """Segments of a few samples, Gauss-Newton steps with the nodes eliminated (the default method in time).

    Source: Bock, Kostina, Schlöder (2007), Numerical methods for parameter estimation in nonlinear differential
    algebraic equations, GAMM-Mitteilungen 30.

    Parameters
    ----------
    segment : int, optional
        Samples a segment; by default chosen from the growth of the unstable poles, between 5 and 10.
    integrator : Integrator
        `RungeKutta()` or, for stiff models, `Rosenbrock()`.
    hessian : "gauss-newton" or "exact"
        "exact" solves with IPOPT, as does `ipopt=True`.
    ipopt : bool
        Solve one sparse problem with IPOPT instead of eliminating the nodes.
    compile : bool
        Translate the step to C once and keep it; needs a C compiler.
    """

    segment: int | None = None
    integrator: Integrator = field(default_factory=RungeKutta)
    hessian: str = "gauss-newton"
    ipopt: bool = False
    compile: bool = False

    def __post_init__(self) -> None:
        """Check the options."""
        if self.segment is not None and (not isinstance(self.segment, int) or self.segment < 1):
            raise ValueError(f"segment {self.segment!r} must be a whole number of samples, at least 1, or None.")
        if self.hessian not in ("gauss-newton", "exact"):
            raise ValueError(f"hessian {self.hessian!r} is not known: use 'gauss-newton' or 'exact'.")
