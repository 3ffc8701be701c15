"""What all criteria share, in the frequency domain and in time: a name, words, and equality by type and settings."""

import dataclasses
import inspect
import re
from abc import ABC
from collections.abc import Callable, Mapping, Sequence, Set
from typing import Any, ClassVar

import numpy as np

from greybox.modeling.model_reference import source_text


class AnyCriterion(ABC):
    """The rule that measures the mismatch of model and data; its value is the cost.

    Two criteria are equal when they are of one class and have the same `settings`. A subclass is a
    frozen dataclass with its settings as fields.

    Attributes
    ----------
    rule : str
        The formula in words, for the reader of a result; `description` completes it with the
        options. By default the `name`.
    condition : str
        What the errors must be like for the standard errors to hold.
    smoothed : bool
        True when the cost has a kink at a zero residual, so that the solver minimizes it with a
        small smoothing.
    known_noise : bool
        True when the size of the errors is given with the data rather than estimated from the
        residuals.
    is_likelihood : bool
        True when the cost is a negative log-likelihood (up to a constant of the data), so that it
        can be compared with that of other such criteria, by AIC and BIC too.
    nuisances : int
        How many variances of the errors the cost eliminates, which are estimated along for every
        response.
    is_prior : bool
        True where the data are a-priori knowledge of the parameters, whose errors are what they are
        said to be.
    """

    rule: ClassVar[str] = ""
    condition: ClassVar[str]
    smoothed: ClassVar[bool] = False
    known_noise: ClassVar[bool] = False
    is_likelihood: ClassVar[bool] = False
    nuisances: ClassVar[int] = 0
    is_prior: ClassVar[bool] = False

    @property
    def variant(self) -> str:
        """What distinguishes it from the usual form of its rule; empty for the usual form."""
        return ""

    @property
    def name(self) -> str:
        """The short name for JSON and the command line: the class in lower case, such as ``relative-error:model``."""
        words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", type(self).__name__.lstrip("_")).lower()
        return f"{words}:{self.variant}" if self.variant else words

    @property
    def description(self) -> str:
        """The rule in words, with its options."""
        return self.rule or self.name

    def condition_on(self, data: Any) -> str:
        """Return the condition for these data."""
        return self.condition

    def gain_bias(self, noise: float, points: int) -> float:
        """Return the relative error of the gain by relative noise of this size in each component of so many points."""
        return 0.0

    @property
    def class_path(self) -> str:
        """The class as ``module:Class``, for those of greybox itself ``greybox:Class``."""
        module = type(self).__module__
        return f"{'greybox' if module.startswith('greybox.') else module}:{type(self).__qualname__}"

    @property
    def settings(self) -> dict[str, Any]:
        """The fields by name in plain values that JSON can hold.

        A function stands there as its source text with the values that it captures: two functions
        are the same when these are. (Two lambdas in one line of source have one text.)
        """
        if dataclasses.is_dataclass(self):
            return {
                field.name: _plain(getattr(self, field.name)) for field in dataclasses.fields(self)
            }
        return {
            name: _plain(value) for name, value in vars(self).items() if not name.startswith("_")
        }

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        assert isinstance(other, AnyCriterion)
        return self.settings == other.settings

    def __hash__(self) -> int:
        return hash((type(self), *self.settings))


def _plain(value: Any) -> Any:
    """Return a setting as JSON can hold it."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Sequence | Set):
        return [
            _plain(item) for item in (sorted(value, key=repr) if isinstance(value, Set) else value)
        ]
    return _function_text(value) if inspect.isroutine(value) else repr(value)


def _function_text(function: Callable[..., Any]) -> str:
    """Return the source of a function, and the values of the variables around it that it uses."""
    closure = getattr(function, "__closure__", None) or ()
    captured = [
        *(getattr(function, "__defaults__", None) or ()),
        *(cell.cell_contents for cell in closure),
    ]
    return "; ".join([source_text(function), *map(repr, captured)])
