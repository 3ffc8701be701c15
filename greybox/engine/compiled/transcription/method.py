"""The base of transcriptions: options, unknowns and equations of a record, and its step."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import casadi as ca

from greybox.data.files.argument_checks import require_kind, require_whole
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.engine.compiled.sample_step import SampleStep
from greybox.engine.compiled.sampled_data import SampledData
from greybox.modeling.implicit_integrators import Radau
from greybox.modeling.integrators import Integrator, RungeKutta


@frozen
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
        Returns the unknowns for states (n, samples) in the order of the samples, padding of
        segments included.
    """

    unknowns: ca.MX
    residuals: ca.MX
    equations: ca.MX
    initial: ca.MX
    start: Callable[[Array], Array]


@public
@dataclass(frozen=True)
class Transcription(ABC):
    """A way to treat the states of records while parameters are estimated.

    The same solution must follow from two descriptions: `transcribe` gives the unknowns and
    equations that a solver sees, `scheme` the step from sample to sample that they amount to.
    Costs, residuals, standard errors and the check of the discretization come from the second.

    Parameters
    ----------
    segment : int, optional
        Samples between the nodes of multiple shooting, which every method starts from; by default
        chosen from the growth of the unstable poles, between 5 and 10.
    hessian : "gauss-newton" or "exact"
        Hessian of the problem that IPOPT solves.

    Examples
    --------
    >>> isinstance(gb.Collocation(), gb.Transcription)  # one of the included ones
    True
    """

    segment: int | None = None
    hessian: Literal["gauss-newton", "exact"] = "gauss-newton"
    label: ClassVar[str]

    def __post_init__(self) -> None:
        """Check the options."""
        if self.segment is not None:
            require_whole("segment", self.segment, 1)
        if self.hessian not in ("gauss-newton", "exact"):
            raise ValueError(
                f"hessian {self.hessian!r} is not known: use 'gauss-newton' or 'exact'."
            )

    @property
    def by_ipopt(self) -> bool:
        """True when IPOPT solves the whole problem."""
        return True

    @property
    @abstractmethod
    def scheme(self) -> Integrator:
        """The integrator whose steps satisfy the equations."""

    @abstractmethod
    def transcribe(self, step: SampleStep, data: SampledData, q: ca.MX, rows: Any) -> Transcribed:
        """Return unknowns and equations for parameters q; `rows` (width, samples) as in `step`."""

    def for_stiff_models(self) -> "Transcription":
        """Return the method for models that are too fast for explicit steps."""
        return self

    @property
    def other_cure(self) -> str:
        """What else helps where steps are too long or fail, for the end of a sentence."""
        if self.scheme.implicit:
            return "; if a formula jumps, such as gb.sign(v), smooth it, gb.tanh(v / width)"
        return (
            "; if the model is stiff, with time constants far below a sample, use "
            f"method={type(self).__name__}(integrator=Radau())"
        )

    def described(self, segment_length: int, substeps: int) -> str:
        """Return the method in words, with what was chosen."""
        segments = f"{counted(segment_length, 'sample')} per segment"
        return (
            f"{self.label}, {segments}, {self.scheme.name}, {counted(substeps, 'step')} per sample"
        )

    def finer(self, substeps: int) -> str:
        """Return the option of `fit` for this many steps per sample, for a warning."""
        return self._option(integrator=replace(self.scheme, substeps=substeps))

    def _option(self, **changes: Any) -> str:
        """Return the option of `fit` with these changes and all other choices."""
        changed = replace(self, **changes)
        usual = type(self)()
        arguments = (
            f"{k}={getattr(changed, k)!r}"
            for k in vars(self)
            if k in changes or getattr(self, k) != getattr(usual, k)
        )

        return f"method={type(self).__name__}({', '.join(arguments)})"


@dataclass(frozen=True)
class Shooting(Transcription):
    """A transcription that simulates with an integrator.

    Parameters
    ----------
    integrator : Integrator, optional
        `RungeKutta()`, or `Radau()` for stiff models; by default as the poles along the data
        need.
    """

    integrator: Integrator | None = None

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        require_kind("integrator", self.integrator, Integrator | None, "RungeKutta() or Radau()")

    @property
    def scheme(self) -> Integrator:
        """The integrator."""
        return self.integrator or RungeKutta()

    def for_stiff_models(self) -> Transcription:
        """Return the method with an implicit integrator, unless one was chosen."""
        return self if self.integrator else replace(self, integrator=Radau())
