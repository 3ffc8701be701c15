"""How a test shall divide its time: the shares of the frequencies that make an estimate most precise."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# What a share may be off by: a thousandth of the flight is less than the rounding of a sine to whole periods.
SMALLEST_SHARE = 1e-3


def time_needed(information: Array, wanted: Array) -> float:
    """Return the shortest time, s, after which every error is at most as wanted.

    Parameters
    ----------
    information : (p, p) array
        Fisher information that a second brings.
    wanted : (p,) array
        Standard errors; infinite for parameters that do not matter.
    """
    try:
        variance = np.diag(np.linalg.inv(information))
    except np.linalg.LinAlgError:
        return np.inf
    return float(np.max(variance / wanted**2)) if (variance > 0).all() else np.inf


def shares(informations: Array, wanted: Array) -> Array:
    """Return the shares (n,) of the flight time by which the wanted errors are reached soonest.

    The variance of an estimate is convex in the shares, so the problem is: minimize s such that every variance is at
    most s times the wanted one (Fedorov 1972, Theory of Optimal Experiments; Goodwin and Payne 1977, Dynamic System
    Identification, chapter 6).

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

    def variances(w: Array) -> tuple[Array, Array]:
        inverse = np.linalg.inv(np.tensordot(w, informations, 1))
        slope = -np.einsum("ij,njk,ki->in", inverse, informations, inverse)
        return np.asarray(np.diag(inverse)[matters], dtype=float), slope[matters]

    begin = np.full(count, 1 / count)
    unit = float(np.max(variances(begin)[0]))
    outcome = minimize(
        lambda z: z[-1],
        np.append(begin, 1.0),
        jac=lambda z: np.append(np.zeros(count), 1.0),
        bounds=[*([(0.0, 1.0)] * count), (0.0, None)],
        constraints=[
            _at_least_zero(
                lambda z: z[-1] - variances(z[:-1])[0] / unit,
                lambda z: np.column_stack([-variances(z[:-1])[1] / unit, np.ones(int(matters.sum()))]),
            ),
            {"type": "eq", "fun": lambda z: z[:-1].sum() - 1, "jac": lambda z: np.append(np.ones(count), 0.0)},
        ],
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-9},
    )
    found = np.clip(outcome.x[:-1], 0, None)
    found[found < SMALLEST_SHARE] = 0
    return found / found.sum()


def wanted_scale(wanted: Array) -> Array:
    """Return the units (p,) in which every wanted error is one."""
    return np.where(np.isfinite(wanted), wanted, 1.0)


def _at_least_zero(value: Callable[[Array], Array], slope: Callable[[Array], Array]) -> dict[str, object]:
    return {"type": "ineq", "fun": value, "jac": slope}
