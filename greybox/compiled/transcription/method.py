"""What every transcription is: options, and the unknowns and equations that stand for a simulated record."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.sample_step import SampleStep
from greybox.compiled.sampled_data import Experiment
from greybox.modeling.integrators import Integrator, RungeKutta


@dataclass(frozen=True, eq=False)
class Transcribed:
    """One record for a solver of nonlinear programs.

    Attributes
    ----------
    unknowns : casadi.MX
        A vector of states.
    residuals : casadi.MX
        (k, samples), zero where nothing was measured.
    equations : casadi.MX
        What must be zero.
    initial : casadi.MX
        (n, stretches), the states at the first samples.
    start : function
        Returns the unknowns for states (n, samples) in the order of the samples, padding of segments included.
    """

    unknowns: ca.MX
    residuals: ca.MX
    equations: ca.MX
    initial: ca.MX
    start: Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Transcription(ABC):
    """A way to treat the states of records while parameters are estimated.

    Parameters
    ----------
    segment : int, optional
        Samples between the nodes of multiple shooting, which every method starts from; by default chosen from the
        growth of the unstable poles, between 5 and 10.
    integrator : Integrator
        `RungeKutta()` or, for stiff models, `Rosenbrock()`.
    hessian : "gauss-newton" or "exact"
        Of the problem that IPOPT solves.
    """

    segment: int | None = None
    integrator: Integrator = field(default_factory=RungeKutta)
    hessian: Literal["gauss-newton", "exact"] = "gauss-newton"
    compile: ClassVar[bool] = False
    label: ClassVar[str]

    def __post_init__(self) -> None:
        """Check the options."""
        if self.segment is not None and (not isinstance(self.segment, int) or self.segment < 1):
            raise ValueError(f"segment {self.segment!r} must be a whole number of samples, at least 1, or None.")
        if not isinstance(self.integrator, Integrator):
            raise TypeError(f"integrator is {self.integrator!r:.60}: give RungeKutta() or Rosenbrock().")
        if self.hessian not in ("gauss-newton", "exact"):
            raise ValueError(f"hessian {self.hessian!r} is not known: use 'gauss-newton' or 'exact'.")

    @property
    def by_ipopt(self) -> bool:
        """True when IPOPT solves the whole problem."""
        return True

    @abstractmethod
    def transcribe(self, step: SampleStep, experiment: Experiment, q: ca.MX, data: Any) -> Transcribed:
        """Return the record's unknowns and equations for parameters q; `data` (width, samples) as `step` reads them."""
