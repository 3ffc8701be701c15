"""A record with its model, compiled independently of segments and substeps."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, BoolArray, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.intersample import Intersample
from greybox.data.record import Record
from greybox.engine.compiled.initial_states import InitialStates
from greybox.engine.compiled.part import Portable
from greybox.engine.compiled.sample_step import SampleStep, sample_step
from greybox.engine.compiled.transcription.method import Transcription
from greybox.engine.compiled.vectorized import Columns
from greybox.modeling.formula_arguments import Names
from greybox.modeling.formulation.input_assumptions import between_samples
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.signal_bias import bias_name
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.modeling.integrators import Integrator
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.realization import Dynamics, dynamics
from greybox.modeling.symbolic_reading import as_column, called, dense_jacobian


@frozen
class RecordModel(Portable):
    """A record and its model, independent of segments and substeps.

    The problem, with its record and its criterion, stays where it was compiled when this is
    pickled: solvers need only the rest.

    Attributes
    ----------
    biases : tuple of str
        Outputs and inputs with an unknown constant error.
    corrects_states : bool
        Whether the residuals of a sample correct the states.
    system : Dynamics
        Its delays include those of interpolated inputs.
    between : tuple of Intersample
        How each input varies between its samples.
    parameters, outside_names : tuple of str
        The declared parameters, by the model's names and the problem's; then the gains that follow
        from process noise.
    gains : tuple of (str, str)
        State and output of every entry of the Kalman gain that is estimated, or follows from
        process noise.
    driven : tuple of str
        States whose process noise is estimated.
    begin : (m,) array
        The start values of the model's parameters.
    active : (q,) array
        Places of the estimated parameters among the declared ones.
    has_time : bool
        Whether the record's samples follow one another in time.
    is_prior : bool
        Whether the record represents a-priori knowledge, not data.
    locate : Columns
        (z) -> values of the declared parameters, derivatives of the active ones by z, delays, known
        initial states, and their derivatives by the active parameters; derivatives row by row.
    initial : casadi.Function
        (declared parameters) -> known initial states.
    known_states : (n,) bool array
    steps : dict
        The samples compiled so far, by integrator and substeps; models that differ only in their
        data share it.
    expressions : tuple of str
        The expression of z of every declared parameter. A hash would differ in every process, and
        with it the fingerprint by which stored runs are found again.
    """

    problem: Problem
    name: str
    weight: float
    biases: tuple[str, ...]
    corrects_states: bool
    has_bounded_errors: bool
    has_time: bool
    is_prior: bool
    method: Transcription
    system: Dynamics
    between: tuple[Intersample, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outside_names: tuple[str, ...]
    gains: tuple[tuple[str, str], ...]
    driven: tuple[str, ...]
    begin: Array
    active: IntArray
    locate: Columns
    initial: ca.Function
    known_states: BoolArray
    initial_states: InitialStates
    steps: dict[tuple[Integrator, int], SampleStep]
    expressions: tuple[str, ...]

    @property
    def record(self) -> Record:
        """The record, where it was compiled."""
        return self.problem.record

    @property
    def criterion(self) -> TimeCriterion:
        """The criterion, where it was compiled."""
        criterion = self.problem.criterion
        assert isinstance(criterion, TimeCriterion)
        return criterion

    def step(self, integrator: Integrator, substeps: int) -> SampleStep:
        """Compile one sample, or return it where that was done before."""
        # Excerpts and parts with other outputs need no new sample.
        key = (integrator, substeps)
        if key not in self.steps:
            # Another process compiles finer steps: nothing here may ask for the problem.
            self.steps[key] = sample_step(
                self.system,
                [between.held for between in self.between],
                self.parameters,
                integrator,
                substeps,
                biases=self.biases,
                corrects_states=self.corrects_states,
            )

        return self.steps[key]


SharedFunctions = tuple[Dynamics, ca.Function, InitialStates, dict[Any, SampleStep]]
"""Dynamics, known initial states, initial states at the nodes, and samples by their steps."""


def record_model(
    problem: Problem,
    expressions: Mapping[str, Any],
    z: ca.SX,
    method: Transcription,
    shared: list[tuple[Any, SharedFunctions]],
) -> RecordModel:
    """Compile a record's model; `expressions` are the parameters at z, by outside name.

    Records of one kind have their functions in common: `shared` has those compiled so far.
    """
    model, record, criterion = problem.model, problem.record, problem.criterion
    assert isinstance(criterion, TimeCriterion)
    outputs = criterion.compared(model, record)
    between = between_samples(criterion.inputs, model.input_names, record)
    gains = criterion.gains(model, outputs)
    driven = criterion.driven()
    parameters = tuple(problem.declared)
    if driven:
        parameters += tuple(f"K_{state}_{output}" for state, output in gains)

    # Models without arguments are of one kind if their classes are.
    alike = type(model) if vars(model) == {"arguments": ((), {})} else id(model)
    kind = criterion, problem.delay, parameters, outputs, between, alike
    functions = next((functions for other, functions in shared if other == kind), None)
    if functions is None:
        functions = _shared_functions(problem, criterion, parameters, outputs, between)
        shared.append((kind, functions))
    system, known, initial_states, steps = functions

    # Gains that follow from process noise come last; the filter fills them in.
    declared = problem.local_values(expressions).values()
    q = ca.vertcat(*declared, ca.SX.zeros(len(parameters) - len(declared)))
    slope = ca.jacobian(q, z)
    # Gains that follow from process noise have no expression in z: the filter gives their slopes.
    following = range(len(problem.declared), q.numel())
    active = sorted({*slope.sparsity().row(), *following})
    delay = system.delay(q[: len(system.parameters)])
    symbol = ca.SX.sym("q", q.numel())
    by_active = ca.substitute(dense_jacobian(known(symbol), symbol[active]), symbol, q)
    located = (q, slope[active, :].T, delay, known(q), by_active.T)

    return RecordModel(
        problem=problem,
        name=problem.name,
        weight=float(problem.weight),
        biases=tuple(criterion.biases),
        corrects_states=criterion.corrects_states,
        has_bounded_errors=not criterion.error_distribution.is_normal,
        has_time=record.has_time,
        is_prior=criterion.is_prior,
        method=method,
        system=system,
        between=between,
        outputs=outputs,
        parameters=parameters,
        outside_names=tuple(map(problem.outside, parameters)),
        gains=gains,
        driven=driven,
        begin=np.array([*problem.local_starts.values()], dtype=float)[: len(system.parameters)],
        active=np.array(active, dtype=int),
        locate=Columns(ca.Function("locate", [z], [*map(ca.densify, located)])),
        initial=known,
        known_states=np.array([name in criterion.initial for name in system.states], dtype=bool),
        initial_states=initial_states,
        steps=steps,
        expressions=tuple(map(str, ca.vertsplit(q))),
    )


def _shared_functions(
    problem: Problem,
    criterion: TimeCriterion,
    parameters: tuple[str, ...],
    outputs: tuple[str, ...],
    between: Sequence[Intersample],
) -> SharedFunctions:
    """Compile the functions that records of one kind share."""
    # Instants between the samples at which an input was read count as delays.
    system = dynamics(problem.model, delay_order(problem.delay)).observed(outputs)
    system = system.later([intersample.late for intersample in between])
    symbol = ca.SX.sym("q", len(parameters))
    local = Names(
        dict(zip(problem.declared, ca.vertsplit(symbol), strict=False)), problem.model.label
    )
    states = [
        called(f"initial[{name!r}]", value, local) if callable(value) else value
        for name in system.states
        for value in [criterion.initial.get(name, math.nan)]
    ]
    if system.undelayed:
        # In addition to the rest at the first inputs, which differs between stretches.
        bias = [-local[bias_name(i)] if i in criterion.biases else 0 for i in system.inputs]
        states[len(system.undelayed.states) :] = ca.vertsplit(system.delay_rest(ca.vertcat(*bias)))

    known = ca.Function("known", [symbol], [as_column(states)])
    return system, known, InitialStates(system), {}


def longest_delay(problem: Problem, system: Dynamics) -> Array:
    """Return the longest delay (m,) of every input within the bounds, s.

    An unbounded delay counts with its start.
    """
    system = system.undelayed or system
    if not system.delayed:
        return np.zeros(len(system.inputs))
    values: dict[str, float] = {}
    # A search may reach the bound, and must compare the same samples all the way.
    for name, p in problem.parameters.items():
        high = p.bounds[1] if math.isfinite(p.bounds[1]) else max(p.box[1], p.start)
        values[name] = p.start if p.fixed or not math.isfinite(high) else high
    q = list(problem.local_values(values).values())[: len(system.parameters)]
    return np.maximum(system.delay(q).full().ravel(), 0.0)
