"""Where to look for other minima than the one that all runs reach.

Two poles that swap, or the resistors of a ladder, have other values with the same response, and few
random starts lead there. Each parameter is held at some values while the others move, and then
released: this crosses the ridge between two minima. It is done for many points at once, which needs
the cost of responses; for a record whose model is linear, these are the responses of the model at
its minimum.
"""

from contextlib import suppress
from functools import partial
from itertools import product

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.named_values import places_of
from greybox.engine.compiled.compiled_problem import CompiledProblem, compile_problem
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.solve.batched_newton import BatchedNewton
from greybox.engine.solve.minima import RIVAL, distinct_ends, likelihood_unit
from greybox.engine.solve.response_solver import ResponseSolver
from greybox.modeling.formulation.frequency_criteria import SquaredRelativeError
from greybox.modeling.linear_response import frequency_response

SHARES = np.array([0.125, 0.875])  # of a start box, where a parameter is held


def points_beside(nlp: CompiledProblem, x: Array) -> Array:
    """Return up to two points (m, p) that fit nearly as well as the minimum x (p,), or better."""
    alike = nlp
    # There may be no operating point, or an option that only a record has.
    with suppress(ValueError):
        alike = _in_frequency(nlp, x)
    if not ResponseSolver.serves(alike):
        return x[:0]

    places = places_of(alike.free, nlp.free)
    best = x[places]
    boxes = [alike.problem.parameters[name].in_box(SHARES) for name in alike.free]
    held = np.tile(np.eye(len(best), dtype=bool), len(SHARES))
    starts = np.vstack([best, np.where(held, np.repeat(boxes, len(best), 1), best[:, None]).T])
    costs = alike.costs(starts)
    # Ten squares, each of an error of a percent, have the sum 1e-3.
    limit = costs[0] + RIVAL * likelihood_unit(alike, costs[0]) + 1e-3
    # A value that fits as it is does not lie beyond a ridge.
    away = costs[1:] > limit
    held = held[:, away]
    z = alike.scaling.to_solver(starts[1:][away]).T
    lower, upper = alike.bounds
    low = np.where(held, z, lower[:, None])
    high = np.where(held, z, upper[:, None])
    # Approximate ends suffice, since runs begin there: kinks of the cost are rounded off.
    search = partial(
        BatchedNewton.of(alike, alike.programs[-1]).minimize,
        max_iterations=50,
        tolerance=1e-8,
        from_near=True,
        smoothing=1e-2,
    )
    # First with a value held, then from there with all values free.
    ends_of_held = search(z, bounds=(low, high))
    z = search(ends_of_held.z).z

    ends = np.vstack([best, alike.estimate_at(z.T)])
    ends = ends[alike.costs(ends) <= limit]
    points = np.array([x] * len(ends))
    points[:, places] = ends
    return points[[group[0] for group in distinct_ends(nlp, points)[1:3]]]


def _in_frequency(nlp: CompiledProblem, x: Array) -> CompiledProblem:
    """Return a problem of responses: those of the first record's model at x (p,), if linear.

    A record with as many outputs as states determines the whole model, and has no others. A model
    without inputs has no response.
    """
    for part in nlp.parts_of(RecordPart)[:1]:
        problem, symbols = part.problem, part.system.symbols
        derivative = part.system.derivative(*symbols)
        is_linear = ca.is_linear(derivative, ca.vertcat(*symbols[:2]))
        if part.system.inputs and len(part.outputs) < part.states and is_linear:
            values = problem.local_values(dict(zip(nlp.names, nlp.all_values(x), strict=True)))
            # From below the lowest frequency of the record to nearly the Nyquist frequency, rad/s.
            omega = np.geomspace(1 / problem.record.duration, 3 / problem.record.step, 10)
            responses = [
                frequency_response(problem.model, values, omega, input=i, output=o)
                for i, o in product(part.system.inputs, part.outputs)
            ]
            first, *others = [
                problem.with_(data=response, criterion=SquaredRelativeError())
                for response in responses
            ]
            return compile_problem(sum(others, first))
    return nlp
