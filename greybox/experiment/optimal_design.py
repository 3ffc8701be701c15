"""How a test shall divide its time: the shares of the frequencies that make an estimate most precise."""

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from greybox.files.arrays import Array

# What a share may be off by: a thousandth of the flight is less than the rounding of a sine to
# whole periods.
SMALLEST_SHARE = 1e-3
FLOOR = 1e-9  # of what all tell of a parameter: its effect on what matters is below the rounding of a share
STEPS = 2000  # of the shares towards the optimum, each a few products of small matrices
CLOSE = 1e-6  # to the optimum, relative: what the slopes of shares in use may differ by

# Of an information whose parameters have size one: below, rounding of sensitivities alone tells
# parameters apart.
SINGULAR = 1e-10

Optimality = Literal["A", "D"]


def time_needed(information: Array, wanted: Array) -> float:
    """Return the shortest time, s, after which every error is at most as wanted.

    Parameters
    ----------
    information : (p, p) array
        Fisher information that a second brings.
    wanted : (p,) array
        Standard errors; infinite for parameters that do not matter.
    """
    variance, matters = variances(information), np.isfinite(wanted)
    return (
        float(np.max(variance[matters] / wanted[matters] ** 2))
        if (variance[matters] > 0).all()
        else np.inf
    )


def variances(information: Array) -> Array:
    """Return the variances (p,); NaN for a parameter of which nothing is told, or for all that are not told apart."""
    told = np.diag(information) > 0
    found = np.full(len(information), np.nan)
    try:
        found[told] = np.diag(np.linalg.inv(information[np.ix_(told, told)]))
    except np.linalg.LinAlgError:
        return np.full(len(information), np.nan)
    return found


def require_determined(information: Array, names: Sequence[str], test: str, cure: str) -> None:
    """Raise a ValueError, which names the `test` and the `cure`, where the information leaves a parameter open."""
    size = np.sqrt(np.diag(information))
    silent = [name for name, s in zip(names, size, strict=True) if not s > 0]
    if silent:
        raise ValueError(f"{test} tells of {silent[0]}: fix it, or {cure}.")
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    if values[0] < SINGULAR:
        together = [name for name, v in zip(names, vectors[:, 0], strict=True) if abs(v) > 0.1]
        raise ValueError(f"{test} tells {', '.join(together)} apart: fix one of them, or {cure}.")


def shares(informations: Array, wanted: Array) -> Array:
    """Return the shares (n,) of the flight time by which the wanted errors are reached soonest.

    The variance of an estimate is convex in the shares, so the problem is: minimize s such that
    every variance is at most s times the wanted one (Fedorov 1972, Theory of Optimal Experiments;
    Goodwin and Payne 1977, Dynamic System Identification, chapter 6).

    Parameters
    ----------
    informations : (n, p, p) array
        Fisher information that a second at each of n frequencies brings, in parameters of size one.
    wanted : (p,) array
    """
    from scipy.optimize import minimize  # noqa: PLC0415 - takes as long to import as all of greybox

    count = len(informations)
    matters = np.isfinite(wanted)
    informations = informations * np.outer(wanted_scale(wanted), wanted_scale(wanted))
    # A parameter that does not matter may be told by none of those that are used: its variance
    # stays finite.
    floor = FLOOR * np.diag(np.diag(informations.mean(axis=0)))

    def with_slope(w: Array) -> tuple[Array, Array]:
        inverse = np.linalg.inv(np.tensordot(w, informations, 1) + floor)
        slope = -np.einsum("ij,njk,ki->in", inverse, informations, inverse)
        return np.asarray(np.diag(inverse)[matters], dtype=float), slope[matters]

    begin = np.full(count, 1 / count)
    unit = float(np.max(with_slope(begin)[0]))
    outcome = minimize(
        lambda z: z[-1],
        np.append(begin, 1.0),
        jac=lambda z: np.append(np.zeros(count), 1.0),
        bounds=[*([(0.0, 1.0)] * count), (0.0, None)],
        constraints=[
            _at_least_zero(
                lambda z: z[-1] - with_slope(z[:-1])[0] / unit,
                lambda z: np.column_stack(
                    [-with_slope(z[:-1])[1] / unit, np.ones(int(matters.sum()))]
                ),
            ),
            {
                "type": "eq",
                "fun": lambda z: z[:-1].sum() - 1,
                "jac": lambda z: np.append(np.ones(count), 0.0),
            },
        ],
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-9},
    )
    found = np.where(outcome.x[:-1] < SMALLEST_SHARE, 0.0, outcome.x[:-1])
    return found / found.sum()


def optimal_shares(informations: Array, optimal: Optimality) -> Array:
    """Return the shares (n,) of a given time by which the errors of all parameters together are smallest.

    Each share grows by what a little more of it would bring, against the mean of all (Silvey,
    Titterington and Torsney 1978, An Algorithm for Optimal Designs on a Finite Design Space); at
    the optimum that is one for all in use.

    Parameters
    ----------
    informations : (n, p, p) array
        Fisher information that a second of each brings, in parameters of size one.
    optimal : "A" or "D"
    """
    w = np.full(len(informations), 1 / len(informations))
    for _ in range(STEPS):
        inverse = np.linalg.inv(np.tensordot(w, informations, 1))
        weight = inverse if optimal == "D" else inverse @ inverse
        slope = np.einsum("ij,nji->n", weight, informations)
        ratio = slope / (w @ slope)
        if ratio.max() < 1 + CLOSE:
            break
        w = w * (ratio if optimal == "D" else np.sqrt(ratio))
        w = w / w.sum()
    w[w < SMALLEST_SHARE] = 0
    return w / w.sum()


def size_of_errors(information: Array, optimal: Optimality) -> float:
    """Return the sum of the variances, or the logarithm of their determinant; infinite where one is not determined."""
    values = np.linalg.eigvalsh(information)
    if not values[0] > 1e-12 * values[-1]:
        return np.inf
    return float(np.sum(1 / values) if optimal == "A" else -np.sum(np.log(values)))


def wanted_scale(wanted: Array) -> Array:
    """Return the units (p,) in which every wanted error is one."""
    return np.where(np.isfinite(wanted), wanted, 1.0)


def _at_least_zero(
    value: Callable[[Array], Array], slope: Callable[[Array], Array]
) -> dict[str, object]:
    return {"type": "ineq", "fun": value, "jac": slope}
