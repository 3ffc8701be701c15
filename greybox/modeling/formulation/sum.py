"""Problems that are solved together: costs add, parameters with the same name are shared."""

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
    """The base class of problems and sums: `+` and the built-in `sum` join them to a `Sum`."""

    @property
    def as_added(self: Any) -> tuple[Any, ...]:
        """The parts as they were added, with their own criteria and unnumbered biases."""
        return self.parts

    def parts_with(self: Any, kind: Any) -> list[Any]:
        """Return the parts whose data are of a class, such as `Record`."""
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
        """Require that a parameter tied in one part is tied alike, or absent, in all others.

        Functions cannot be compared, so that their values are: at the start and at four random
        points, where different formulas agree with probability zero. One point is not enough, since
        formulas may be undefined there.
        """
        merged = self.parameters
        # Bounds may be infinite.
        low, high = np.clip(lower_and_upper(merged.values()), -1e3, 1e3)
        drawn = np.random.default_rng(0).uniform(low, high, (4, len(merged)))
        points = [dict(zip(merged, point, strict=True)) for point in (start_values(merged), *drawn)]

        # The values (5,) of every tied parameter, as its first part ties it.
        first_values: dict[str, list[float]] = {}
        for part in self.parts:
            for name in part.tied:
                outside = part.outside(name)
                values = [part.local_values(point)[name] for point in points]
                expected = first_values.setdefault(outside, values)
                is_alike = np.allclose(expected, values, equal_nan=True)
                if outside in merged or not is_alike:
                    raise ValueError(
                        f"{outside!r} is tied in {part.name!r} and free or tied differently in "
                        "another part: tie it alike in all, or give one another name, "
                        f"rename={{{name!r}: ...}}."
                    )

    def with_parts(self, parts: Sequence[Part]) -> "Sum[Part]":
        """Return the sum of other parts, under the same name."""
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
        estimates: dict[str, HeldEstimate] = {}
        for part in self.parts:
            estimates |= part.held_estimates
        return estimates

    def with_(self, **changes: Any) -> "Sum[Part]":
        """Return the sum with these fields changed in every part; `name` is that of the sum."""
        name = changes.pop("name", self.name)
        return Sum(tuple(part.with_(**changes) for part in self.as_added), name)

    def __repr__(self) -> str:
        return one_line(self, repr(self.name), counted(len(self.parts), "part"))


def _joined_names(parts: Sequence[Any]) -> str:
    """Return the names of the parts in one line, which has room for about eight."""
    names = unique(part.name for part in parts)
    if len(names) > 8:
        names = (*names[:2], "...", f"{names[-1]} ({len(names)} in all)")
    return " + ".join(names)


def _require_data_once(problem: Sum[Any]) -> None:
    """Refuse a record together with a response or spectrum that was estimated from it.

    Both have the same errors, so that the sum of their likelihoods would count the information
    twice.

    Raises
    ------
    ValueError
        With the times of the common data.
    """
    records = problem.parts_with(Record)
    for part in problem.parts:
        for stretch in part.kind.source_stretches(part.data):
            for record in records:
                if _contains(record.data, stretch):
                    raise ValueError(
                        f"{part.name!r} was estimated from {stretch.start:g} to {stretch.end:g} s "
                        f"of the record {record.name!r}, which would count the same data twice: "
                        "leave one of them out, or fit the record between other times, "
                        "record.between(start, end)."
                    )


def _contains(record: Record, stretch: Stretch) -> bool:
    """Return whether a record contains more than one sample of a stretch of a log."""
    # One common sample is not an overlap: stretches of a log may share their ends.
    first, last = np.searchsorted(record.time, [stretch.start, np.nextafter(stretch.end, np.inf)])
    return record.checksum == stretch.checksum and int(last - first) > 1


def _with_costs_that_add(parts: Sequence[Any]) -> tuple[Any, ...]:
    """Return the parts with criteria whose costs may be added.

    Negative log-likelihoods of any data add. If one criterion is a likelihood, as that of every
    record is, a response without a stated criterion has `RelativeLikelihood` instead of
    `RelativeError`. Other costs have different scales, and add only if criterion and settings are
    the same.

    Raises
    ------
    ValueError
        If one criterion is a likelihood and another is not, or if two others differ.
    """
    # If one part is a likelihood, the sum is one, and all other parts must be likelihoods, too.
    likelihood = next((part for part in parts if part.criterion.is_likelihood), None)
    first = likelihood or parts[0]
    adding = []
    for part in parts:
        if likelihood and part.has_default_criterion and not part.criterion.is_likelihood:
            part_that_adds = part.with_(criterion=RelativeLikelihood())
        else:
            part_that_adds = part
        adding.append(part_that_adds)

    for part in adding:
        if likelihood:
            is_addable = part.criterion.is_likelihood
        else:
            is_addable = part.criterion == first.criterion
        if not is_addable:
            raise ValueError(
                f"{part.name!r} has the criterion {part.criterion!r} and {first.name!r} "
                f"{first.criterion!r}: costs of different criteria add only where both are "
                "likelihoods, so leave out the criterion of the response, or give both the same "
                "criterion, or RelativeLikelihood(), or MaximumLikelihood() where variances are "
                "known."
            )

    return tuple(adding)


def numbered_parts(parts: Sequence[Any]) -> Iterator[Any]:
    """Yield the parts with the names of sensor biases numbered, if several records have them.

    Parts of one record share its biases. A bias that a part renames, even to its own name, is not
    numbered: records can so share it. Nor is one that is fixed at an earlier fit, where it has this
    name. Equal names of parts are numbered, too: flights of one model are often all named like it.
    """
    # The number of the record of every part.
    numbers = _record_numbers(parts)
    outside_names = [{part.outside(name) for name in part.declared} for part in parts]
    names_in_use = set().union(*outside_names)

    # The new name of a bias, by its name and the number of its record.
    numbered: dict[tuple[str, int], str] = {}
    part_names = numbered_where_alike([part.name for part in parts])
    for part, record, part_name in zip(parts, numbers, part_names, strict=True):
        renamed = {}
        for name in part.criterion.bias_names:
            is_held = isinstance(part.fixed_values.get(name), HeldEstimate)
            if name in part.rename or is_held:
                continue
            # A bias that only one record has keeps its plain name.
            owners = {
                owner for owner, names in zip(numbers, outside_names, strict=True) if name in names
            }
            if len(owners) < 2:
                continue
            if (name, record) not in numbered:
                number = record
                while f"{name}_{number}" in names_in_use:
                    number += 1
                numbered[name, record] = f"{name}_{number}"
                names_in_use.add(f"{name}_{number}")
            renamed[name] = numbered[name, record]

        if renamed or part_name != part.name:
            yield part.with_(name=part_name, rename={**part.rename, **renamed})
        else:
            yield part


def _record_numbers(parts: Sequence[Any]) -> list[int]:
    """Return the number of every part's record, counted from one; zero for other data."""
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
