"""The sines of the shortest flight that reaches wanted errors, and their lengths.

Begin with `shortest_flight`.
"""

from collections.abc import Iterator

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.workflows.experiment.optimal_design import shares, time_needed

# A flight that is shorter by less than this share is not worth another search.
WORTH_WHILE = 1e-3
# Smallest ratio of neighboring frequencies, a third of an octave: closer sines have nearly the same
# information, and do not show whether the model is right elsewhere.
APART = 2 ** (1 / 3)
# Condition number of the information above which its inverse has no digit left.
SINGULAR = 1e14
# Rounding errors of lengths and variances.
ROUNDING = 1e-9


@frozen
class Candidates:
    """Sines that may be flown, n of them, and the information of a second of each.

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
        """Return whether sines at these increasing places are far enough apart.

        The smallest ratio of neighboring frequencies is `APART`. In a band that is too narrow for
        `number` sines at this ratio, it is that of half the even spacing, on a logarithmic scale.
        """
        half_spacing = (self.period[0] / self.period[-1]) ** (0.5 / number)
        ratios = self.period[places[:-1]] / self.period[places[1:]]
        return bool(np.all(ratios > min(APART, half_spacing) - ROUNDING))

    def reaches(self, places: IntArray, seconds: Array) -> bool:
        """Return whether sines of these lengths reach all wanted errors."""
        return bool(self._largest_variance(places, seconds) <= 1 + ROUNDING)

    def _largest_variance(self, places: IntArray, seconds: Array) -> float:
        """Return the largest variance of a wanted parameter, in units of its wanted error."""
        total = np.tensordot(seconds, self.information[places], 1)
        if np.linalg.cond(total) > SINGULAR:
            return np.inf
        # Variances fall with one over the time: the factor on the time is the largest variance.
        return time_needed(total, self.matters)

    def flight(self, places: IntArray) -> "Flight":
        """Return the shortest flight of the sines at these places."""
        period = self.period[places]
        least = self.periods * period
        variance = self._largest_variance(places, least)
        if not np.isfinite(variance):
            return Flight(places, least, np.inf)
        seconds = least if variance <= 1 else self._longer(places, least, variance)

        # With whole periods of all sines, the errors are smaller than wanted. A period is left out
        # where the wanted errors allow it, the longest first.
        seconds = np.ceil(seconds / period - ROUNDING) * period
        for k in np.argsort(-period, kind="stable"):
            shorter = seconds.copy()
            shorter[k] -= period[k]
            # Lengths are whole periods: half a period allows for rounding.
            has_enough_periods = shorter[k] > least[k] - 0.5 * period[k]
            if has_enough_periods and self.reaches(places, shorter):
                seconds = shorter
        return Flight(places, seconds, float(np.sum(seconds + self.overhead[places])))

    def _longer(self, places: IntArray, least: Array, variance: float) -> Array:
        """Return the lengths (n,), s, with the smallest sum that reach the wanted errors.

        The variances are convex in the lengths, and so is the problem. At the `least` lengths the
        largest one has this `variance`.
        """
        from scipy.optimize import minimize  # noqa: PLC0415  (slow import)

        informations = self.information[places]
        # Lengths are in units of the time in which the `least` lengths, in proportion, reach the
        # wanted errors.
        unit = variance * least.sum()

        def inverse_at(lengths: Array) -> Array:
            return np.linalg.inv(np.tensordot(lengths * unit, informations, 1))

        def constraints(lengths: Array) -> Array:
            """Return minus the logarithms of the variances, which are one for a wanted error."""
            return -np.log(np.diag(inverse_at(lengths))[self.matters])

        def constraint_slopes(lengths: Array) -> Array:
            inverse = inverse_at(lengths)
            slope = -np.einsum("ij,njk,ki->in", inverse, informations, inverse)
            variances = np.diag(inverse)[self.matters]
            return -(slope[self.matters] / variances[:, None]) * unit

        solution = minimize(
            np.sum,
            variance * least / unit,
            jac=np.ones_like,
            bounds=[(low, None) for low in least / unit],
            constraints={"type": "ineq", "fun": constraints, "jac": constraint_slopes},
            method="SLSQP",
            options={"maxiter": 100, "ftol": 1e-7},
        )
        lengths = np.maximum(solution.x * unit, least)
        # The constraints hold to a few digits only: proportionally longer sines meet them.
        return lengths * max(self._largest_variance(places, lengths), 1.0)


@frozen
class Flight:
    """The sines of a flight.

    Attributes
    ----------
    places : (k,) array of int
        The places of the sines among the candidates.
    seconds : (k,) array, s
        Their lengths.
    total : float, s
        The whole time; infinite if these sines cannot reach the wanted errors.
    """

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
        flights = []
        for places in _neighbors(best.places, len(candidates.period), fewest):
            if not candidates.are_apart(places, fewest):
                continue
            if _least_time(candidates, places) < best.total:
                flights.append(candidates.flight(places))
        shorter = min(flights, key=lambda flight: flight.total, default=best)
        # The negated comparison is also true where both are infinite.
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
    """Add places in the widest gaps until there are `fewest` of `count`."""
    chosen = {*places.tolist()}
    while len(chosen) < min(fewest, count):
        edges = [-1, *sorted(chosen), count]
        k = int(np.argmax(np.diff(edges)))
        chosen.add((edges[k] + edges[k + 1]) // 2)
    return np.array(sorted(chosen), dtype=int)
