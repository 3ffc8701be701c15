"""Problems that are solved together: costs add, parameters with the same name are shared."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import field
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np

from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.normalization import normalize
from greybox.data.files.printed import one_line, preformatted
from greybox.data.files.public import public
from greybox.data.files.wording import counted, numbered_where_alike
from greybox.data.frequency_response import Stretch
from greybox.data.record import Record
from greybox.modeling.formulation.frequency_criteria import RelativeLikelihood
from greybox.modeling.formulation.held_estimate import HeldEstimate
from greybox.modeling.merged_parameters import merged_parameters
from greybox.modeling.parameter import Parameter, lower_and_upper, parameter_table, start_values

# A part is a `Problem`, whose file imports this one.
Part = TypeVar("Part", bound=Any)


class Addable:
    """What `+` and the built-in `sum` join to a `Sum`."""

    @property
    def as_added(self: Any) -> tuple[Any, ...]:
        """The parts as they were added, with their own criteria and unnumbered biases."""
        return self.parts

    def parts_with(self: Any, kind: Any) -> list[Any]:
        """Return the parts with data of a kind, such as `Record`."""
        return [part for part in self.parts if isinstance(part.data, kind)]

    def __add__(self, other: Any) -> "Sum[Any]":
        if not isinstance(other, Addable):
            return NotImplemented
        return Sum((*self.as_added, *other.as_added))

    def __radd__(self, other: Any) -> Any:
        # The built-in sum() begins with 0.
        return self if other == 0 else NotImplemented

    def _repr_html_(self: Any) -> str:
        return preformatted(f"{self!r}\n\n{parameter_table(self.parameters)}")


@public
@frozen
class Sum(Addable, Generic[Part]):
    """Several problems solved together: costs add, parameters with the same name are shared.

    Each record has its own sensor biases: if several records have ``x_bias``, it becomes
    ``x_bias_1``, ``x_bias_2`` ..., numbered as the records are. Parts of one record share it; so do
    parts that give it one name, ``rename={"x_bias": "x_bias"}``.

    Likelihoods add. In a sum with a likelihood, as every record has, the default criterion of a
    response without variances is `RelativeLikelihood`. Other criteria add only if they are the
    same, with the same settings.

    Raises
    ------
    ValueError
        If costs do not add, a response was estimated from a record in the sum, or parameters of one
        name have different units or are fixed, tied or bounded in contradictory ways.
    """

    parts: tuple[Part, ...]
    name: str = ""

    # For further sums: `a + b + c` must number biases once, over all records.
    _as_added: tuple[Part, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Choose criteria whose costs add, number biases, merge parameters, compare ties."""
        _require_data_once(self)
        normalize(
            self,
            _as_added=self.parts,
            parts=tuple(numbered_parts(_with_costs_that_add(self.parts))),
            name=self.name or _joined_names(self.parts),
        )
        self._check_ties()

    def _check_ties(self) -> None:
        """Require that a name tied in one part is tied alike, or absent, in all others."""
        merged = self.parameters
        # Functions cannot be compared, so their values are.
        # Bounds may be infinite.
        low, high = np.clip(lower_and_upper(merged.values()), -1e3, 1e3)

        # Different formulas agree at a random point with probability zero; there are four points,
        # since formulas may be undefined in places.
        drawn = np.random.default_rng(0).uniform(low, high, (4, len(merged)))
        points = [start_values(merged), *drawn]

        seen: dict[str, list[float]] = {}
        for part in self.parts:
            for name in part.tied:
                outside = part.outside(name)
                values = [
                    part.local_values(dict(zip(merged, point, strict=True)))[name]
                    for point in points
                ]
                alike = np.allclose(seen.setdefault(outside, values), values, equal_nan=True)
                if outside in merged or not alike:
                    raise ValueError(
                        f"{outside!r} is tied in {part.name!r} and free or tied differently in "
                        "another part: tie it alike in all, or give one another name, "
                        f"rename={{{name!r}: ...}}."
                    )

    def with_parts(self, parts: Sequence[Part]) -> "Sum[Part]":
        """Return the sum of other parts in place of these, under the same name."""
        return Sum(tuple(parts), self.name)

    @property
    def as_added(self) -> tuple[Part, ...]:
        """The parts as they were added, with their own criteria and unnumbered biases."""
        return self._as_added

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """The merged parameters by outside name; tied ones are left out."""
        return merged_parameters(self.parts)

    @property
    def held_estimates(self) -> dict[str, HeldEstimate]:
        """Earlier fits among the fixed values, by outside name."""
        return {name: held for part in self.parts for name, held in part.held_estimates.items()}

    def with_(self, **changes: Any) -> "Sum[Part]":
        """Return the same sum with fields of every part changed (`name` is that of the sum)."""
        name = changes.pop("name", self.name)
        return Sum(tuple(part.with_(**changes) for part in self.as_added), name)

    def __repr__(self) -> str:
        return one_line(self, repr(self.name), counted(len(self.parts), "part"))


def _joined_names(parts: Sequence[Any]) -> str:
    """Return the names of the parts; more than eight do not fit into a line."""
    names = unique(part.name for part in parts)
    if len(names) > 8:
        names = *names[:2], "...", f"{names[-1]} ({len(names)} in all)"
    return " + ".join(names)


def _require_data_once(problem: Sum[Any]) -> None:
    """Refuse a record together with a response or spectrum estimated from a stretch of it.

    Their errors are the same, so that adding their likelihoods would count the information twice.

    Raises
    ------
    ValueError
        With the stretch.
    """
    records = problem.parts_with(Record)
    for part in problem.parts:
        for stretch in part.kind.source_stretches(part.data):
            for record in records:
                if _holds(record.data, stretch):
                    raise ValueError(
                        f"{part.name!r} was estimated from {stretch.start:g} to {stretch.end:g} s "
                        f"of the record {record.name!r}, which would count the same data twice: "
                        "leave one of them out, or fit the record between other times, "
                        "record.between(start, end)."
                    )


def _holds(record: Record, stretch: Stretch) -> bool:
    """Return whether a record has samples of a stretch."""
    # One common sample is not an overlap: stretches of a log may share their ends.
    first, last = np.searchsorted(record.time, [stretch.start, np.nextafter(stretch.end, np.inf)])
    return record.checksum == stretch.checksum and int(last - first) > 1


def _with_costs_that_add(parts: Sequence[Any]) -> tuple[Any, ...]:
    """Return the parts with criteria whose costs may be added.

    Negative log-likelihoods add for all data. If one criterion is a likelihood, as that of every
    record, a response without a criterion of its own gets `RelativeLikelihood` instead of
    `RelativeError`. Other costs have different scales: they add only if criterion and settings are
    the same.

    Raises
    ------
    ValueError
        If one criterion is a likelihood and another is not, or if two others differ.
    """
    # One likelihood makes the sum one: all others must be likelihoods too.
    likelihood = next((part for part in parts if part.criterion.is_likelihood), None)
    if likelihood:
        parts = [
            part.with_(criterion=RelativeLikelihood())
            if part.has_default_criterion and not part.criterion.is_likelihood
            else part
            for part in parts
        ]
    first = likelihood or parts[0]
    for part in parts:
        if not (part.criterion.is_likelihood if likelihood else part.criterion == first.criterion):
            raise ValueError(
                f"{part.name!r} has the criterion {part.criterion!r} and {first.name!r} "
                f"{first.criterion!r}: costs of different criteria add only where both are "
                "likelihoods, so leave out the criterion of the response, or give both the same "
                "criterion, or RelativeLikelihood(), or MaximumLikelihood() where variances are "
                "known."
            )

    return tuple(parts)


def numbered_parts(parts: Sequence[Any]) -> Iterator[Any]:
    """Yield the parts with biases numbered by the record, where several records have one.

    Equal names of parts are numbered, too: flights of one model are often all named like it. Parts
    of one record share its biases. A bias is not numbered, so that records can share it, if a
    part renames it (also to its own name) or fixes it at an earlier fit, which has that name.
    """
    numbers = _record_numbers(parts)
    outside = [{part.outside(name) for name in part.declared} for part in parts]
    names_in_use = set().union(*outside)

    numbered: dict[tuple[str, int], str] = {}
    part_names = numbered_where_alike([part.name for part in parts])
    for part, record, part_name in zip(parts, numbers, part_names, strict=True):
        renamed = {}
        for name in part.criterion.bias_names:
            # An earlier fit has the name of its bias.
            is_held = isinstance(part.fixed_values.get(name), HeldEstimate)
            if name in part.rename or is_held:
                continue
            # A bias that only one record has keeps its plain name.
            owners = {k for k, names in zip(numbers, outside, strict=True) if name in names}
            if len(owners) > 1:
                if (name, record) not in numbered:
                    candidates = (f"{name}_{k}" for k in itertools.count(record))
                    new = next(name for name in candidates if name not in names_in_use)
                    numbered[name, record] = new
                    names_in_use.add(new)
                renamed[name] = numbered[name, record]

        changes = {"name": part_name, "rename": {**part.rename, **renamed}}
        yield part.with_(**changes) if renamed or part_name != part.name else part


def _record_numbers(parts: Sequence[Any]) -> list[int]:
    """Return the number of the record of every part, from one; zero for other data."""
    distinct: dict[Any, int] = {}
    numbers = []
    for part in parts:
        number = 0
        if isinstance(part.data, Record):
            # Two stretches of one log have the same checksum, but not the same times.
            identity = (part.data.checksum, len(part.data), *part.data.span)
            number = distinct.setdefault(identity, len(distinct) + 1)
        numbers.append(number)
    return numbers
