"""The cost of a problem as one object for any solver, sampler or library.

An `Objective` knows nothing of a search. It is compiled once, and evaluated at any points: as
vectors of the free parameters in their own units, as the scaled vectors on which solvers work, or
by name.
"""

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Any, Literal

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.public import public
from greybox.data.files.rebuilt import Rebuilt
from greybox.engine.compiled.compiled_problem import AnyProblem, CompiledProblem, compile_problem
from greybox.engine.compiled.transcription.method import Transcription
from greybox.engine.solve.constraints import Limits, limits_of
from greybox.engine.solve.point_costs import PointCosts
from greybox.engine.solve.record_costs import Nodes, ProfiledCosts, SimulatedCosts
from greybox.engine.solve.response_costs import ResponseCosts
from greybox.engine.solve.robust_fit import with_pseudo_values
from greybox.engine.solve.worker_payload import pickled, unpickled
from greybox.modeling.cached_property import cached_property
from greybox.modeling.model import require_known
from greybox.modeling.one_thread import Stored
from greybox.modeling.step_size import MOST_SUBSTEPS

States = Literal["profiled", "simulated"]
KINDS: Mapping[str, type[ProfiledCosts] | type[SimulatedCosts]] = {
    "profiled": ProfiledCosts,
    "simulated": SimulatedCosts,
}

# Change of a cost by twice the steps that is no reason for more of them, and the same relative to
# the cost. A tenth of a standard error changes a likelihood by .005.
NEGLIGIBLE = 1e-3
RELATIVE = 1e-7

Point = Array | Sequence[float] | Values
"""Free parameters (p,) in the order of `names`, several of them (r, p), or values by name."""


@public
def objective(
    problem: AnyProblem,
    at: Values | None = None,
    *,
    method: Transcription | None = None,
    states: States = "profiled",
) -> "Objective":
    """Return the cost of a problem, with its derivatives, as a function of the free parameters.

    It is what a fit minimizes, for other solvers, samplers and libraries.

    Parameters
    ----------
    problem : Problem or a sum of problems
    at : mapping, optional
        Parameters by name, by default their starts. The steps of integration are halved until the
        cost there no longer changes, unless the `method` states a number of steps. Then they stay,
        so that the cost is smooth: where a model is much faster, make another objective. Large
        errors that the criterion bounds are those at these values: give an estimate, at which a fit
        has the same. Fixed parameters get these values, which records refuse.
    method : MultipleShooting, SingleShooting or Collocation, optional
        How records are transcribed, as in `fit`.
    states : "profiled" or "simulated"
        The states of records are those of the smallest cost at every point, as in a fit. Or every
        point is one simulation, and initial states that the problem does not state are those of the
        smallest cost `at` the given values: the least time, and the same cost as long as the
        problem states all initial states.

    Raises
    ------
    ValueError, TypeError
        For bad input, in one sentence.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> objective = gb.objective(pitch_hover.problem())
    >>> objective.names
    ('a1', 'a2', 'a3', 'a4')
    >>> round(objective.value(pitch_hover.published["values"]), 4)
    0.5866
    >>> objective.gradient(objective.start).shape, objective.hessian(objective.start).shape
    ((4,), (4, 4))
    """
    if states not in KINDS:
        raise ValueError(f"states is {states!r:.40}: give 'profiled' or 'simulated'.")
    nlp = compile_problem(problem, method)
    parameters = problem.parameters
    start = np.array([parameters[name].start for name in nlp.free])
    require_known(at or {}, nlp.names, "parameter", repr(problem.name))
    given = [(at or {}).get(name, parameters[name].start) for name in nlp.names]
    values = np.array(given, dtype=float)
    x = values[: len(nlp.free)]
    nlp = nlp.with_constants(values[len(nlp.free) :])
    if not nlp.has_states:
        return Objective(nlp, start)
    costs = with_fine_steps(nlp, x)
    bounded = with_pseudo_values(costs.nlp, x)
    if bounded is not costs.nlp:
        costs = ProfiledCosts(bounded)
    return Objective(costs.nlp, start, states, costs.nodes_at(x))


def with_fine_steps(nlp: CompiledProblem, x: Array) -> ProfiledCosts:
    """Return the costs with so many steps that more of them change nothing at x (p,)."""
    costs = ProfiledCosts(nlp)
    if nlp.method.scheme.substeps is not None:
        return costs
    while 0 < costs.nlp.substeps < MOST_SUBSTEPS:
        cost = costs.at(x).cost
        finer = ProfiledCosts(costs.nlp.refined(2))
        closer = finer.at(x).cost
        has_none = math.isinf(closer) and math.isinf(cost)
        # The first of two equal ones: it is that of a fit with the usual steps.
        if has_none or abs(closer - cost) <= NEGLIGIBLE + RELATIVE * abs(closer):
            break
        costs = finer
    return costs


def objective_near(nlp: CompiledProblem, x: Array) -> "Objective":
    """Return the objective of a compiled problem whose states begin at the best ones at x (p,)."""
    nodes = ProfiledCosts(nlp).nodes_at(x) if nlp.has_states else None
    return Objective(nlp, x, nodes=nodes)


@public
@frozen
class Objective(Rebuilt):
    """The cost of a problem at any values of its free parameters, with its derivatives.

    A point is a vector (p,) in the order of `names`, or a mapping of values by name, in which
    parameters without a value are at their start. Several points are rows (r, p), and every answer
    has them first. `scaled` is the same objective on the scaled variables of the solvers.

    An objective can be pickled: it travels as compiled functions, without the classes of the
    problem. Every thread evaluates functions of its own.

    Attributes
    ----------
    nlp : CompiledProblem
    natural_start : (p,) array
        Starts of the parameters, in their own units.
    states : "profiled" or "simulated"
        See `objective`.
    nodes : sequence of (s, n) arrays, or None
        States of each part at the beginning of every segment, with which a point begins.
    is_scaled : bool
        Whether vectors are scaled variables.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> objective = gb.objective(pitch_hover.problem())
    >>> objective.gradient(objective.start).shape
    (4,)
    """

    nlp: CompiledProblem
    natural_start: Array
    states: States = "profiled"
    nodes: Nodes | None = None
    is_scaled: bool = False
    thread: int = field(default_factory=threading.get_ident, init=False)
    by_thread: Stored = field(default_factory=lambda: Stored(1), init=False)

    def __repr__(self) -> str:
        coordinates = "scaled variables" if self.is_scaled else "parameters"
        return f"Objective({len(self.names)} {coordinates}: {', '.join(self.names)})"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of every vector."""
        return self.nlp.free

    @cached_property
    def start(self) -> Array:
        """Return the declared starts (p,), in the coordinates of the objective."""
        return self.to_scaled(self.natural_start) if self.is_scaled else self.natural_start

    @cached_property
    def lower(self) -> Array:
        """Return lower bounds (p,), in the coordinates of the objective."""
        return self.nlp.bounds[0] if self.is_scaled else self.nlp.lower

    @cached_property
    def upper(self) -> Array:
        """Return upper bounds (p,), in the coordinates of the objective."""
        return self.nlp.bounds[1] if self.is_scaled else self.nlp.upper

    @cached_property
    def scaled(self) -> "Objective":
        """Return the same objective on the scaled variables in which solvers work."""
        return Objective(self.nlp, self.natural_start, self.states, self.nodes, is_scaled=True)

    def to_scaled(self, parameters: Array) -> Array:
        """Return the scaled variables (..., p) of parameters (..., p)."""
        return self.nlp.scaling.to_solver(np.asarray(parameters, dtype=float))

    def to_parameters(self, scaled: Array) -> Array:
        """Return the parameters (..., p) of scaled variables (..., p)."""
        return self.nlp.scaling.to_parameters(np.asarray(scaled, dtype=float))

    def by_name(self, point: Point) -> dict[str, float]:
        """Return the free parameters of a point by name."""
        return dict(zip(self.names, self._parameters(point)[0].tolist(), strict=True))

    @property
    def is_least_squares(self) -> bool:
        """Whether half the sum of the squared residuals is the cost, up to a constant.

        That is so where the sizes of all errors are given. Otherwise they follow from the
        residuals, at every point.
        """
        return self._costs.is_least_squares

    # --- the cost and its derivatives

    def value(self, point: Point) -> Any:
        """Return the cost, or costs (r,); infinite where the model has none."""
        x = self._parameters(point)
        costs = self._costs.costs(x)
        return costs if self._is_many(point) else float(costs[0])

    def gradient(self, point: Point) -> Array:
        """Return the derivatives (p,) of the cost, or (r, p); not finite where it has none."""
        x = self._parameters(point)
        gradients = self._costs.gradients(x)
        if not self.is_scaled:
            gradients = gradients * self.nlp.scaling.slope(x)
        return gradients if self._is_many(point) else gradients[0]

    def hessian(self, point: Point) -> Array:
        """Return the second derivatives (p, p) of the cost, or (r, p, p).

        They are exact where all data are frequency responses. With records or spectra they are
        those of Gauss and Newton, JᵀJ.
        """
        x = self._parameters(point)
        hessians = self._costs.hessians(x)
        if not self.is_scaled:
            slope = self.nlp.scaling.slope(x)
            hessians = hessians * slope[:, :, None] * slope[:, None, :]
            if self._costs.is_exact:
                bend = self._costs.gradients(x) * self.nlp.scaling.bend(x)
                hessians = hessians + bend[:, :, None] * np.eye(len(self.names))
        return hessians if self._is_many(point) else hessians[0]

    def value_and_gradient(self, point: Point) -> tuple[Any, Array]:
        """Return the cost with its derivatives, as `scipy.optimize.minimize` takes them."""
        return self.value(point), self.gradient(point)

    # --- residuals

    def residuals(self, point: Point) -> Array:
        """Return the residuals (m,), or (r, m), in standard deviations of their errors.

        With the Jacobian J, Jᵀ times the residuals is the gradient of the cost, and JᵀJ the
        information on which standard errors are based. Half the sum of their squares is the cost
        where `is_least_squares` says so.

        Raises
        ------
        ValueError
            Where the model diverges.
        """
        return self._by_row(point, self._costs.residuals)

    def jacobian(self, point: Point) -> Array:
        """Return the derivatives (m, p) of the residuals, or (r, m, p), for errors of this size.

        Raises
        ------
        ValueError
            Where the model diverges.
        """
        costs, slope = self._costs, self.nlp.scaling.slope

        def rows(x: Array) -> Array:
            return costs.jacobian(x) / slope(x) if self.is_scaled else costs.jacobian(x)

        return self._by_row(point, rows)

    # --- what must not be negative

    @property
    def limits(self) -> tuple[str, ...]:
        """What each constraint is, in words; empty for most problems."""
        return self.nlp.limits

    def constraints(self, point: Point) -> Array:
        """Return what must be >= 0, (c,) or (r, c)."""
        return self._by_row(point, lambda x: self._limited(x)[0])

    def constraint_jacobian(self, point: Point) -> Array:
        """Return the derivatives (c, p) of the constraints, or (r, c, p)."""
        slope = self.nlp.scaling.slope

        def rows(x: Array) -> Array:
            by_scaled = self._limited(x)[1]
            return by_scaled if self.is_scaled else by_scaled * slope(x)

        return self._by_row(point, rows)

    def _limited(self, x: Array) -> tuple[Array, Array]:
        """Return constraints (c,) and their derivatives (c, p) by the scaled variables."""
        values, slopes = self._limits.constraints(self.to_scaled(x)[:, None])
        return values[:, 0], slopes.reshape(-1, len(x))

    @cached_property
    def _limits(self) -> Limits:
        return limits_of(self.nlp)

    # --- points

    @property
    def _costs(self) -> PointCosts:
        """The functions of this thread."""
        return self.by_thread.result("", self._build)

    def _build(self) -> PointCosts:
        # Two threads must not call one CasADi function at a time.
        is_own = threading.get_ident() == self.thread
        nlp = self.nlp if is_own else unpickled(pickled(self.nlp))
        if not nlp.has_states:
            return ResponseCosts(nlp)
        return KINDS[self.states](nlp, self.nodes)

    @staticmethod
    def _is_many(point: Point) -> bool:
        return not isinstance(point, Mapping) and np.ndim(point) > 1

    def _parameters(self, point: Point) -> Array:
        """Return a point or several as parameters (r, p)."""
        if isinstance(point, Mapping):
            return self._named(point)[None]
        values = np.atleast_2d(np.asarray(point, dtype=float))
        if values.ndim != 2 or values.shape[1] != len(self.names):
            raise ValueError(
                f"a point has {len(self.names)} values, those of {', '.join(self.names)}, and this "
                f"array has the shape {np.shape(point)}: give (p,), or (r, p) for several points."
            )
        return self.to_parameters(values) if self.is_scaled else values

    def _named(self, values: Values) -> Array:
        require_known(values, self.nlp.names, "parameter", "the objective")
        constants = dict(zip(self.nlp.constants, self.nlp.constant_values.tolist(), strict=True))
        for name, constant in constants.items():
            if values.get(name, constant) != constant:
                raise ValueError(
                    f"{name} is fixed at {constant:g} in this objective: make one with "
                    f"gb.objective(problem, {{{name!r}: {values[name]:g}}})."
                )
        pairs = zip(self.names, self.natural_start.tolist(), strict=True)
        return np.array([values.get(name, start) for name, start in pairs], dtype=float)

    def _by_row(self, point: Point, function: Callable[[Array], Array]) -> Array:
        """Return the values of a function of parameters (p,) at a point, or at several."""
        rows = np.array([function(x) for x in self._parameters(point)])
        return rows if self._is_many(point) else rows[0]
