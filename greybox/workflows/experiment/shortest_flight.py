"""Which sines a flight has, and for how long, so that it reaches wanted errors soonest.

Begin with `shortest_flight`.
"""

from collections.abc import Iterator

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.workflows.experiment.optimal_design import shares, time_needed

# A flight that is shorter by less than this share is not worth another search.
WORTH_WHILE = 1e-3
# Sines are a third of an octave apart: closer ones tell nearly the same, and nothing of whether the
# model is right elsewhere.
APART = 2 ** (1 / 3)


@frozen
class Candidates:
    """Sines that may be flown, n of them, and what a second of each tells of p parameters.

    Attributes
    ----------
    information : (n, p, p) array
        Fisher information of one second, for parameters in units of their wanted errors.
    matters : (p,) array of bool
        Which errors are wanted.
    period, overhead : (n,) arrays, s
        Length of a period, and what a sine costs besides: its time to settle, and a pause.
    periods : int
        Least number of periods of a sine.
    """

    information: Array
    matters: BoolArray
    period: Array
    overhead: Array
    periods: int

    def are_apart(self, places: IntArray, number: int) -> bool:
        """Return whether sines at these increasing places are apart, as `number` of them can be.

        In a narrow band they are half as far apart as if they divided it evenly.
        """
        evenly = (self.period[0] / self.period[-1]) ** (0.5 / number)
        ratios = self.period[places[:-1]] / self.period[places[1:]]
        return bool(np.all(ratios > min(APART, evenly) - 1e-9))

    def reaches(self, places: IntArray, seconds: Array) -> bool:
        """Return whether sines of these lengths reach all wanted errors."""
        return bool(self._largest_variance(places, seconds) <= 1 + 1e-9)

    def _largest_variance(self, places: IntArray, seconds: Array) -> float:
        total = np.tensordot(seconds, self.information[places], 1)
        # Beyond this condition number the inverse has no digit left.
        if np.linalg.cond(total) > 1e14:
            return np.inf
        return time_needed(total, self.matters)

    def flight(self, places: IntArray) -> "Flight":
        """Return the shortest flight of the sines at these places."""
        period, least = self.period[places], self.periods * self.period[places]
        variance = self._largest_variance(places, least)
        if not np.isfinite(variance):
            return Flight(places, least, np.inf)
        seconds = least if variance <= 1 else self._longer(places, least, variance)

        seconds = np.ceil(seconds / period - 1e-9) * period
        # Rounding up all sines is more than the errors need: the longest periods first.
        for k in np.argsort(-period, kind="stable"):
            shorter = seconds - period * (np.arange(len(period)) == k)
            if shorter[k] > least[k] - 0.5 * period[k] and self.reaches(places, shorter):
                seconds = shorter
        return Flight(places, seconds, float(np.sum(seconds + self.overhead[places])))

    def _longer(self, places: IntArray, least: Array, variance: float) -> Array:
        """Return the lengths (n,), s, with the smallest sum that reach the wanted errors.

        The variances are convex in the lengths, and so is the problem. At the `least` lengths the
        largest one has this `variance`.
        """
        from scipy.optimize import minimize  # noqa: PLC0415  (slow import)

        informations = self.information[places]

        def log_variance(seconds: Array) -> tuple[Array, Array]:
            inverse = np.linalg.inv(np.tensordot(seconds, informations, 1))
            slope = -np.einsum("ij,njk,ki->in", inverse, informations, inverse)
            variances = np.diag(inverse)[self.matters]
            return np.log(variances), slope[self.matters] / variances[:, None]

        unit = variance * least.sum()  # with all lengths in proportion, the errors are reached
        lengths = minimize(
            np.sum,
            variance * least / unit,
            jac=np.ones_like,
            bounds=[(low, None) for low in least / unit],
            constraints={
                "type": "ineq",
                "fun": lambda t: -log_variance(t * unit)[0],
                "jac": lambda t: -log_variance(t * unit)[1] * unit,
            },
            method="SLSQP",
            options={"maxiter": 100, "ftol": 1e-7},
        ).x
        lengths = np.maximum(lengths * unit, least)
        # The constraints hold to a few digits only: proportionally longer sines meet them.
        return lengths * max(self._largest_variance(places, lengths), 1.0)


@frozen
class Flight:
    """The sines at these places of the candidates, their lengths in s, and the whole time in s."""

    places: IntArray
    seconds: Array
    total: float


def shortest_flight(candidates: Candidates, fewest: int) -> Flight:
    """Return the flight that no other choice of one sine makes shorter; its total may be infinite.

    The search begins with the sines of the optimal design, whose shares of the time concentrate on
    few frequencies. Then sines are left out, put elsewhere in the band, or added, one at a time,
    for as long as that shortens the flight. It keeps `fewest` sines at least, all of them apart.
    """
    best = _of_optimal_design(candidates, fewest)
    while True:
        flights = [
            candidates.flight(places)
            for places in _neighbors(best.places, len(candidates.period), fewest)
            if candidates.are_apart(places, fewest) and _least_time(candidates, places) < best.total
        ]
        shorter = min(flights, key=lambda flight: flight.total, default=best)
        if not shorter.total < best.total * (1 - WORTH_WHILE):
            return best
        best = shorter


def _least_time(candidates: Candidates, places: IntArray) -> float:
    """Return the time of a flight whose sines have the fewest periods, s."""
    least = candidates.periods * candidates.period[places]
    return float(np.sum(least + candidates.overhead[places]))


def _neighbors(places: IntArray, count: int, fewest: int) -> Iterator[IntArray]:
    """Yield all choices of sines that differ in one of them, from `count` candidates."""
    unused = np.setdiff1d(np.arange(count), places)
    for k in range(len(places)):
        others = np.delete(places, k)
        if len(others) >= fewest:
            yield others
        for place in unused:
            yield np.sort([*others, place])
    for place in unused:
        yield np.sort([*places, place])


def _of_optimal_design(candidates: Candidates, fewest: int) -> Flight:
    """Return the shortest flight of sines of the optimal design: of one, of two, and so on."""
    count = len(candidates.period)
    share = shares(candidates.information, candidates.matters)
    places = np.zeros(0, dtype=int)
    best = Flight(places, np.zeros(0), np.inf)
    for place in np.argsort(-share, kind="stable"):
        more = np.sort([*places, place])
        if candidates.are_apart(more, fewest):
            places = more
            flight = candidates.flight(with_spare_sines(places, count, fewest))
            best = min(best, flight, key=lambda flight: flight.total)
    return best


def with_spare_sines(places: IntArray, count: int, fewest: int) -> IntArray:
    """Return `fewest` places of `count` at least, the further ones in the widest gaps."""
    chosen = {*places.tolist()}
    while len(chosen) < min(fewest, count):
        edges = [-1, *sorted(chosen), count]
        k = int(np.argmax(np.diff(edges)))
        chosen.add((edges[k] + edges[k + 1]) // 2)
    return np.array(sorted(chosen), dtype=int)
