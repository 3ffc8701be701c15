"""Optimal designs: the shares of the flight time that make an estimate most precise."""

from collections.abc import Sequence

import numpy as np

from greybox.data.files.arrays import Array, BoolArray


def time_needed(information: Array, matters: BoolArray) -> float:
    """Return the shortest time, s, after which no error that matters exceeds one.

    Parameters
    ----------
    information : (p, p) array
        Fisher information of one second, for parameters in units of their wanted errors.
    matters : (p,) array of bool
    """
    return float(np.max(np.diag(np.linalg.inv(information))[matters]))


def require_determined(information: Array, names: Sequence[str]) -> None:
    """Raise a ValueError if no sine determines a parameter, or separates it from others."""
    size = np.sqrt(np.diag(information))
    for name, s in zip(names, size, strict=True):
        if not s > 0:
            raise ValueError(
                f"no sine in this band has information on {name}: fix it, or choose another band."
            )
    # With unit diagonal, the result does not depend on the units of the parameters.
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    if values[0] < 1e-10:  # rounding of the sensitivities
        combined = np.array(names)[np.abs(vectors[:, 0]) > 0.1]
        raise ValueError(
            f"no sine in this band separates {', '.join(combined)}: fix one of them, or choose "
            "another band."
        )


def shares(informations: Array, matters: BoolArray) -> Array:
    """Return the shares (n,) of the flight time that reach the wanted errors soonest.

    The variance of an estimate is convex in the times, so the problem is: minimize their sum such
    that every variance that matters is at most one (Fedorov 1972, Theory of Optimal Experiments;
    Goodwin and Payne 1977, Dynamic System Identification, chapter 6).

    Parameters
    ----------
    informations : (n, p, p) array
        Fisher information of one second at each of n frequencies, for parameters in units of their
        wanted errors.
    matters : (p,) array of bool
    """
    from scipy.optimize import minimize  # noqa: PLC0415  (slow import)

    count = len(informations)
    # The frequencies in use may have no information on a parameter that does not matter: this keeps
    # its variance finite.
    floor = 1e-9 * np.diag(np.diag(informations.mean(axis=0)))

    def with_slope(w: Array) -> tuple[Array, Array]:
        inverse = np.linalg.inv(np.tensordot(w, informations, 1) + floor)
        slope = -np.einsum("ij,njk,ki->in", inverse, informations, inverse)
        variance = np.diag(inverse)[matters]
        return np.log(variance), slope[matters] / variance[:, None]

    # The times with the smallest sum. The unit of time is the one in which equal shares of one
    # suffice. A variance is far from its tangents, and infinite if all times that it needs are
    # zero: without the logarithm and a least time, one of a hundred searches ended there, and
    # rounding decided which. With both, none of 1958 was 0.1 % above the best answer.
    begin = np.full(count, 1 / count)
    unit = with_slope(begin)[0].max()
    times = minimize(
        np.sum,
        begin,
        jac=np.ones_like,
        bounds=[(1e-6 / count, None)] * count,
        constraints={
            "type": "ineq",
            "fun": lambda t: unit - with_slope(t)[0],
            "jac": lambda t: -with_slope(t)[1],
        },
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-9},
    ).x
    # A thousandth of the flight is less than the rounding of a sine to whole periods.
    times[times < 1e-3 * times.sum()] = 0
    return times / times.sum()
