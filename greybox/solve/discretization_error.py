"""Is the integration accurate enough for the noise? What twice the substeps would do to the estimate.

A fixed-step integrator with too few substeps shifts the parameters without a trace in the residuals: it damps and
slows oscillations by itself. The shift follows from the gradient that the finer integration has at the estimate,
in units of the standard errors that white noise gives; what is far below them does not matter.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.compiled.record_part import Path, Place, RecordPart
from greybox.modeling.integrators import Integrator, Rosenbrock
from greybox.modeling.step_size import MOST_SUBSTEPS, substep_growth
from greybox.solve.gauss_newton.driver import GaussNewton, Profile
from greybox.solve.ipopt import SMOOTHING, Outcome, Run
from greybox.solve.minima import Multistart, find_minima

Array = NDArray[np.float64]
SMALL = 0.1  # of a standard error: a shift that does not matter
EXACT = 1e-7  # of states and outputs: what finer substeps change is rounding
RIVAL, RIVALS = 10.0, 3  # minima that may change places with the best: by cost above it, and number
SAME_END = 0.01  # relative difference of parameters up to which two runs of one minimum have one end
RANK = 1e-12  # of the largest eigenvalue of the Hessian in units of its diagonal


@dataclass(frozen=True, eq=False)
class IntegrationError:
    """What half as long substeps would change.

    Attributes
    ----------
    shift : (p,) array
        Of the unknowns, in standard errors; or the relative change of these where that is more: at the limit of its
        stability an integrator knows rates that the model does not show.
    order : int
        The shift falls with this power of the number of substeps.
    """

    shift: Array
    order: int

    @property
    def largest(self) -> float:
        """The largest shift, in standard errors."""
        return float(np.abs(self.shift).max(initial=0.0))

    @property
    def growth(self) -> int:
        """How many times as many substeps make the shift small, as far as its order tells; at most eight times."""
        return substep_growth(self.largest, SMALL, self.order)


def integration_error(nlp: Nlp, profile: Profile) -> IntegrationError:
    """Return what twice the substeps would do to the estimate that `profile` belongs to, to first order."""
    p = len(nlp.free)
    ways = list(zip(nlp.records, profile.paths, profile.places, strict=True))
    fine = [part.refined(2, compiled=False) for part, _, _ in ways]
    finer = [refined.path(path.nodes, place) for refined, (_, path, place) in zip(fine, ways, strict=True)]
    rounding = [
        not part.states or _is_rounding(part, path, other) for (part, path, _), other in zip(ways, finer, strict=True)
    ]
    hessian = np.zeros((p, p)) if all(rounding) else _of_responses(nlp, profile.z)
    hessian_fine, change = hessian.copy(), np.zeros(p)
    for (part, path, place), refined, other, same in zip(ways, fine, finer, rounding, strict=True):
        if all(rounding):
            break
        H, g = _gradient(part, path, place, path)
        H_fine, g_fine = (H, g) if same else (H, np.full(p, math.inf))
        if not same and other.finite:
            H_fine, g_fine = _gradient(refined, other, place, path)
        weight = part.part.weight
        hessian, hessian_fine = hessian + weight * H, hessian_fine + weight * H_fine
        change += weight * (g_fine - g)
    orders = [part.method.integrator.order for part in nlp.records]
    shift, widened = _in_errors(hessian, change), _widened(hessian, hessian_fine)
    return IntegrationError(np.where(widened > np.abs(shift), widened, shift), min(orders, default=1))


def well_integrated(nlp: Nlp, search: Multistart) -> tuple[Nlp, Multistart, IntegrationError | None]:
    """Refine the substeps until that does not matter, and follow the best minima; what the method fixes stays.

    Returns the error that is left too, where it was looked at.
    """
    error = None
    while search.minima and nlp.records and all(part.method.integrator.substeps is None for part in nlp.records):
        error = integration_error(nlp, GaussNewton(nlp).profile(search.minima[0].estimate, search.nodes))
        if error.largest <= SMALL or max(part.substeps for part in nlp.records) >= MOST_SUBSTEPS:
            break
        finer = replace(nlp, records=tuple(part.refined(error.growth) for part in nlp.records))
        followed = _followed(finer, search)
        if followed is None:
            break
        nlp, search = finer, followed
    return nlp, search, error


def _followed(nlp: Nlp, search: Multistart) -> Multistart | None:
    """Return the search with its best minima, as far as they are rivals, moved to those of `nlp`; None if none is.

    The runs that ended there move with them, so that runs and minima tell the same costs. What is no rival stays.
    """
    solver, limit = GaussNewton(nlp), search.minima[0].cost + RIVAL
    ends: dict[int, Outcome] = {}
    count, least = 0, math.inf
    for m in search.minima:
        if not ((count < RIVALS and m.cost <= limit) or m.cost < least < math.inf):
            break
        ends |= _ends(nlp, solver, [search.runs[k] for k in m.runs])
        count, least = count + 1, min((end.cost for end in ends.values() if end.converged), default=math.inf)
    if math.isinf(least):
        return None
    runs = tuple(_moved(run, ends[run.index]) if run.index in ends else run for run in search.runs)
    traces = [ends[run.index].trace if run.index in ends else None for run in runs]
    minima = (*find_minima(nlp, [run for run in runs if run.index in ends], traces), *search.minima[count:])
    minima = tuple(sorted(minima, key=lambda m: m.cost))
    return replace(search, runs=runs, minima=minima, nodes=ends[minima[0].runs[0]].nodes)


def _ends(nlp: Nlp, solver: GaussNewton, runs: Sequence[Run]) -> dict[int, Outcome]:
    """Return where the runs of one minimum end with the substeps of `nlp`; those of one end move together."""
    found: list[tuple[Array, Outcome]] = []
    ends = {}
    for run in runs:
        z = nlp.scaling.to_solver(run.estimate)
        near = (o for other, o in found if np.all(np.abs(z - other) <= SAME_END * (np.abs(other) + 1e-3)))
        outcome = next(near, None)
        if outcome is None:
            outcome = solver.run(run.estimate)
            found.append((z, outcome))
        ends[run.index] = outcome
    return ends


def _moved(run: Run, end: Outcome) -> Run:
    converged, cost = end.converged, float(end.cost)
    return replace(run, estimate=end.estimate, cost=cost, converged=converged, status=end.status)


def integration_warnings(nlp: Nlp, profile: Profile | None, error: IntegrationError | None = None) -> Iterator[str]:
    """Say so where the integration is not accurate enough for the noise."""
    if profile is None or not nlp.records:
        return
    error = error or integration_error(nlp, profile)
    if error.largest > SMALL:
        name = nlp.free[int(np.argmax(np.abs(error.shift)))]
        count = max(part.substeps for part in nlp.records)
        by = f"{error.largest:.2g} standard errors" if math.isfinite(error.largest) else "more than the model bears"
        yield (
            f"the integration is too coarse: {2 * count} substeps a sample instead of {count} would change {name}, or "
            f"its error, by {by}; {_cure(nlp.records[0].method.integrator, count, error.growth)}."
        )


def _cure(integrator: Integrator, count: int, growth: int) -> str:
    """Say what to integrate with: many more explicit steps are the second choice, being the slower one."""
    finer = f"{type(integrator).__name__}(substeps={growth * count})"
    if isinstance(integrator, Rosenbrock):
        return (
            f"use method=MultipleShooting(integrator={finer}), or RungeKutta() in its place if the model is not stiff"
        )
    if count >= MOST_SUBSTEPS:
        return (
            "if the model is stiff, with time constants far below a sample, use "
            f"method=MultipleShooting(integrator=Rosenbrock()), otherwise {finer} in its place"
        )
    return f"use method=MultipleShooting(integrator={finer}), or Rosenbrock() in its place if the model is stiff"


def _gradient(part: RecordPart, path: Path, place: Place, best: Path) -> tuple[Array, Array]:
    """Return Hessian and gradient by the unknowns along a path with gaps, weighted by the noise of the best path."""
    blocks = part.linearize(path, place, part.noise.weight(best.products))
    reduced = part.reduce(blocks, place, path.gaps, np.zeros(part.states))
    return reduced.hessian, reduced.gradient


def _of_responses(nlp: Nlp, at: Array) -> Array:
    """Return the Hessian (p, p) of the cost of frequency responses."""
    z, s, f = (nlp.expressions[name] for name in "xpf")
    found = ca.Function("hessian", [z, s], [ca.hessian(f, z)[0]])(at, SMOOTHING).full()
    values, vectors = np.linalg.eigh((found + found.T) / 2)
    return (vectors * np.abs(values)) @ vectors.T


def _is_rounding(part: RecordPart, path: Path, finer: Path) -> bool:
    size = np.abs(path.states).max(axis=1, initial=0.0)
    moved = np.abs(finer.end - path.end).max(axis=0, initial=0.0)
    return bool(np.all(moved <= EXACT * size))


def _in_errors(hessian: Array, change: Array) -> Array:
    """Return the Newton step -H⁻¹ g in units of its standard errors, in the directions that the data see."""
    if not np.all(np.isfinite(change)):
        return np.full(len(change), math.inf)
    size = np.sqrt(np.maximum(np.diag(hessian), 0.0))
    unit = 1 / np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(hessian * unit * unit[:, None])
    seen = values > RANK * values.max(initial=0.0)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    errors = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    return -(inverse @ (change * unit)) / np.where(errors > 0, errors, 1.0)


def _widened(coarse: Array, fine: Array) -> Array:
    """Return the relative change of the errors of every unknown alone, others known, (p,); 0 where nothing is seen."""
    a, b = (np.maximum(np.diag(H), 0.0) for H in (coarse, fine))
    seen = a > 0
    return np.where(seen, np.abs(np.sqrt(b / np.where(seen, a, 1.0)) - 1), 0.0)
