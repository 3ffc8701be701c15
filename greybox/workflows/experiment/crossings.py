"""Where curves of many plants change their sign, and the quantities of the plants there."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, IntArray
from greybox.data.files.frozen_values import frozen


class Located(NamedTuple):
    """A quantity of every plant, and the frequency at which it occurs, both (plants,).

    The value is infinite where it does not exist, NaN where it is not defined.
    """

    value: Array
    omega: Array

    @property
    def first(self) -> tuple[float, float]:
        """The value and the frequency of the first plant."""
        return float(self.value[0]), float(self.omega[0])


Numbers = dict[str, Located]


@frozen
class Crossings:
    """Where the curves of many plants change their sign: one row for each crossing.

    Attributes
    ----------
    plants : int
        The number of curves.
    plant, place : (k,) arrays of int
        The index of the curve, in ascending order, and of the point before the crossing.
    share : (k,) array
        Position of the crossing between this point and the next one, from 0 to 1.
    omega : (k,) array
    """

    plants: int
    plant: IntArray
    place: IntArray
    share: Array
    omega: Array

    def between(self, values: Array) -> Array:
        """Interpolate other curves (plants, n) at the crossings (k,)."""
        before = values[self.plant, self.place]
        after = values[self.plant, self.place + 1]
        return before + self.share * (after - before)

    def where(self, condition: BoolArray) -> "Crossings":
        """Return the crossings at which a condition (k,) is true."""
        names = ("plant", "place", "share", "omega")
        return replace(self, **{name: getattr(self, name)[condition] for name in names})

    def smallest(self, values: Array) -> Located:
        """Return the smallest of the values (k,) of each plant; infinity for none."""
        answer = Located(np.full(self.plants, math.inf), np.full(self.plants, np.nan))
        # If several values are assigned to one plant, the last one remains.
        falling = np.argsort(values, kind="stable")[::-1]
        falling = falling[np.isfinite(values[falling])]
        for array, numbers in zip(answer, (values, self.omega), strict=True):
            array[self.plant[falling]] = numbers[falling]
        return answer

    @property
    def first(self) -> Located:
        """The lowest frequency of each plant; infinity for none."""
        return self.smallest(self.omega)

    @property
    def last(self) -> Located:
        """The highest frequency of each plant; minus infinity for none."""
        value, omega = self.smallest(-self.omega)
        return Located(-value, omega)

    def listed(self, name: str, values: Array) -> Numbers:
        """Return one entry for each crossing of the first plant, empty if it has fewer than two.

        An entry contains the values, from `values` (k,), of all plants at their crossing of this
        rank. They are infinite for plants with fewer crossings.
        """
        # The rank counts 0, 1, 2 ... within each plant: rows are in the order of plants, and those
        # of a plant in the order of frequency.
        rank = np.arange(len(self.plant)) - np.searchsorted(self.plant, self.plant)
        count = np.count_nonzero(self.plant == 0)
        if count < 2:
            return {}
        answer = {}
        for k in range(count):
            answer[f"{name} {k + 1}"] = self.where(rank == k).smallest(values[rank == k])
        return answer


def crossings(values: Array, omega: Array) -> Crossings:
    """Return where curves (plants, n) change their sign along `omega` (n,), or time."""
    is_negative = values < 0
    plant, place = np.nonzero(is_negative[:, :-1] != is_negative[:, 1:])
    before, after = values[plant, place], values[plant, place + 1]
    share = before / (before - after)
    at = omega[place] + share * (omega[place + 1] - omega[place])
    return Crossings(len(values), plant, place, share, at)
