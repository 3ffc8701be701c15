"""What an objective asks of a compiled problem at a point, whatever its data are."""

from abc import ABC, abstractmethod
from typing import ClassVar

from greybox.data.files.arrays import Array
from greybox.engine.compiled.compiled_problem import CompiledProblem


class PointCosts(ABC):
    """The cost of a compiled problem with its derivatives, for one thread.

    Points are parameters x (p,), or rows (r, p) of them. Derivatives of the cost are those by the
    solver's variables z, in which it is closer to a parabola.

    Attributes
    ----------
    nlp : CompiledProblem
    is_exact : bool
        Whether the Hessians are those of the cost, not those of Gauss and Newton.
    """

    nlp: CompiledProblem
    is_exact: ClassVar[bool]

    @property
    @abstractmethod
    def is_least_squares(self) -> bool:
        """Whether the cost is half the sum of the squared residuals, up to a constant."""

    @abstractmethod
    def costs(self, x: Array) -> Array:
        """Return the costs (r,) at x (r, p); infinite where there is none."""

    @abstractmethod
    def gradients(self, x: Array) -> Array:
        """Return the gradients (r, p) by z, at x (r, p); NaN where there is none."""

    @abstractmethod
    def hessians(self, x: Array) -> Array:
        """Return the Hessians (r, p, p) by z, at x (r, p); NaN where there is none."""

    @abstractmethod
    def residuals(self, x: Array) -> Array:
        """Return the residuals (m,) at x (p,)."""

    @abstractmethod
    def jacobian(self, x: Array) -> Array:
        """Return the derivatives (m, p) of the residuals by x, at x (p,)."""
