"""The base class of all criteria: name, description, and equality by type and settings."""

import dataclasses
import inspect
import re
from abc import ABC
from collections.abc import Mapping, Sequence, Set
from typing import Any, ClassVar

import numpy as np

from greybox.modeling.model_reference import source_text


class AnyCriterion(ABC):
    """The rule that measures the mismatch of model and data; its value is the cost.

    Two criteria are equal if they have the same class and the same `settings`. A subclass is a
    frozen dataclass with its settings as fields.

    Attributes
    ----------
    rule : str
        Formula in words, for the reader of a result; `description` adds the options. By default the
        `name`.
    condition : str
        Errors for which the standard errors are valid.
    smoothed : bool
        Whether the cost has a kink at a zero residual, which the solver smooths.
    known_noise : bool
        Whether the data give the size of the errors; otherwise the residuals do.
    is_likelihood : bool
        Whether the cost is a negative log-likelihood (up to a constant of the data), which can be
        compared with others, also by AIC and BIC.
    nuisances : int
        Number of variances of the errors that are estimated with each response.
    is_prior : bool
        Whether the data are a-priori knowledge of the parameters, with given errors.
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
        """Word for a variant of the rule; empty for the usual form."""
        return ""

    @property
    def name(self) -> str:
        """Short name for JSON and the command line, such as ``relative-error:model``."""
        # `SquaredRelativeError` is called squared-relative-error.
        words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", type(self).__name__.lstrip("_")).lower()
        return f"{words}:{self.variant}" if self.variant else words

    @property
    def description(self) -> str:
        """The rule in words, with its options."""
        return self.rule or self.name

    @property
    def bias_names(self) -> tuple[str, ...]:
        """Names of the added parameters that are constant errors of one record's signals."""
        return ()

    def condition_on(self, data: Any) -> str:
        """Return the condition for these data."""
        return self.condition

    def gain_bias(self, noise: float, points: int) -> float:
        """Return the relative bias of the gain due to relative `noise` in each component."""
        return 0.0

    @property
    def class_path(self) -> str:
        """The class as ``module:Class``, for those of greybox itself ``greybox:Class``."""
        # Without the folder, so that stored results remain readable if a file moves.
        module = type(self).__module__
        return f"{'greybox' if module.startswith('greybox.') else module}:{type(self).__qualname__}"

    @property
    def settings(self) -> dict[str, Any]:
        """The fields by name, as values that JSON can represent.

        A function is represented by its source text and the values that it captures: functions with
        the same text and values are equal. (Two lambdas in one line of source have one text.)
        """
        # A user's criterion may be a plain class, whose attributes are its settings.
        if dataclasses.is_dataclass(self):
            return {
                field.name: _plain(getattr(self, field.name)) for field in dataclasses.fields(self)
            }
        return {
            name: _plain(value) for name, value in vars(self).items() if not name.startswith("_")
        }

    def contains(self, other: "AnyCriterion") -> bool:
        """Return whether this is the `other` criterion, perhaps with further parameters.

        These must have no effect where they are zero: fits by both criteria can then be compared by
        a likelihood-ratio test.
        """
        return self == other

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
    if isinstance(value, int | float | str | None):
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Sequence | Set):
        # The order of a set differs from process to process.
        return [
            _plain(item) for item in (sorted(value, key=repr) if isinstance(value, Set) else value)
        ]

    if not inspect.isroutine(value):
        return repr(value)

    # The source of a function and the values that it captures.
    closure = getattr(value, "__closure__", None) or ()
    captured = [
        *(getattr(value, "__defaults__", None) or ()),
        *(cell.cell_contents for cell in closure),
    ]
    return "; ".join([source_text(value), *map(repr, captured)])
