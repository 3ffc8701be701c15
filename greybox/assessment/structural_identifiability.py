"""Which parameters of a model structure data could determine, by the rank of sensitivities."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np

from greybox.assessment.identifiability import identifiability
from greybox.data.files.argument_checks import as_names, require_kind
from greybox.data.files.arrays import (
    Array,
    BoolArray,
    all_finite,
    positive_or_one,
)
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values, array_of
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.wording import counted, listed
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.engine.compiled.compiled_problem import CompiledProblem, compile_problem
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.record_sensitivity import sensitivity
from greybox.engine.covariance.combinations import Combination, invisible_groups
from greybox.engine.covariance.covariance import informations
from greybox.engine.covariance.known_directions import KnownDirections
from greybox.modeling.formulation.frequency_criteria import SquaredRelativeError
from greybox.modeling.formulation.output_error import OutputError
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.several import several
from greybox.modeling.linearization import jacobians
from greybox.modeling.model import Model, ParameterFormula, require_known
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.realization import dynamics
from greybox.modeling.symbolic_reading import RAMP, limited_parameters, switching_parameters
from greybox.modeling.transfer_function import TransferFunction
from greybox.statistics.column_space import beside

# Number of points at which the rank is computed. At a single point it may be smaller by chance.
POINTS = 3
# Number of frequencies that are drawn for each pair of input and output. They give more equations
# than any structure has parameters.
FREQUENCIES = 40
# Band of these frequencies, rad/s: the band of vehicles and their actuators.
BAND = (1e-2, 1e3)
# Number of stretches of the assumed record, each with its own initial state.
STRETCHES = 4
# Reasons that follow the name of a parameter. A slope of zero does not prove that a parameter has
# no effect.
IN_A_SWITCH = (
    "enters only through a switch or a rounding, which has no slope: neither this test nor a "
    f"solver sees its effect. {RAMP}"
)
BEYOND_A_SWITCH = (
    "has no effect on what was tried here, but its formula has a switch (a limit, a dead zone) "
    "beyond which it may have one: fix it, unless the data go there."
)
# Sizes of inputs and initial states, and relative durations of the record. They are tried in turn
# until all signals stay within the domain of the formulas. Shorter records are tried last: a tank
# without inflow, for example, is soon empty.
SIZES = (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3)
TRIALS = (*((size, 1.0) for size in SIZES), (0.1, 0.3), (0.1, 0.1), (0.01, 0.03))


@frozen
class StructuralIdentifiability(Printed):
    """Which parameters a structure can determine. Printing it names those that it cannot separate.

    Attributes
    ----------
    model : str
    names : tuple of str
        The free parameters.
    groups : tuple of Combination
        Parameters, and initial states, that can move together without any effect. In every group
        as many must be fixed as it has `directions`.
    combinations : tuple of str
        Combinations of such parameters that are determined, products and sums, such as ``K1 K2``.
    data : str
        The assumed measurements, in words.
    reasons : mapping of parameter to str
        Why this test saw no effect of a parameter in `groups`, if formulas contain it in a switch.
    """

    model: str
    names: tuple[str, ...]
    groups: tuple[Combination, ...]
    combinations: tuple[str, ...]
    data: str
    reasons: Mapping[str, str] = field(default_factory=dict)

    @property
    def identifiable(self) -> tuple[str, ...]:
        """The parameters that the structure determines."""
        lost = {name for group in self.groups for name in group.names}
        return tuple(name for name in self.names if name not in lost)

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        yield f"{self.model}, structural identifiability from {self.data}:"
        if not self.groups:
            yield f"  all of {listed(self.names)} can be determined."
            return

        for group in self.groups:
            members = group.members
            if len(members) == 1:
                reason = self.reasons.get(members[0], "has no effect: fix it or remove it.")
                yield f"  {members[0]} {reason}"
            else:
                cure = "one" if group.directions == 1 else str(group.directions)
                yield f"  {listed(members)} cannot be separated: fix {cure} of them."

        lost = len(self.names) - len(self.identifiable)
        missing = lost - sum(group.directions for group in self.groups) - len(self.combinations)
        formulas = [*self.combinations]
        if missing > 0:
            formulas.append(f"{counted(missing, 'combination')} (neither product nor sum)")
        if formulas:
            yield f"  Determined in combination: {listed(formulas)}."
        if self.identifiable:
            yield f"  {listed(self.identifiable)} can be determined."


@public
def structural_identifiability(
    model: Model,
    outputs: Sequence[str] | None = None,
    *,
    at: Values | None = None,
    fixed: Values | None = None,
    free: Sequence[str] = (),
    tied: Mapping[str, ParameterFormula] | None = None,
    initial: Mapping[str, Any] | None = None,
) -> StructuralIdentifiability:
    """Return which parameters inputs and outputs could determine, before there are any data.

    The rank of the sensitivities is computed at random points of the start boxes. For a transfer
    function, or an ODE at an operating point `at`, these are sensitivities of the frequency
    responses of all pairs at 40 frequencies. For any other ODE they are those of the outputs of a
    record with random inputs and unknown initial states. A parameter that moves without an effect
    at the point of the largest rank is not identifiable; `reasons` names those whose effect a
    switch in their formula may hide. The test is local: two lags that can be
    swapped count as identifiable, because every small change of them has an effect.

    Parameters
    ----------
    model : Model
    outputs : sequence of str, optional
        The measured outputs; by default all.
    at, fixed, free, tied : optional
        As in `Problem`; `at` selects the linearized response.
    initial : mapping, optional
        Known initial states, as in `OutputError`.

    Raises
    ------
    ValueError
        For a name that is not known, or if the model is finite at none of the points.

    Sources: Bellman and Åström (1970), On structural identifiability, Mathematical Biosciences 7;
    Jacquez and Greif (1985), Numerical parameter identifiability and estimability, Mathematical
    Biosciences 77.

    Examples
    --------
    >>> from greybox.models.yaw import YawRate
    >>> gb.structural_identifiability(YawRate()).identifiable
    ('a1_tilde', 'a2', 'a3_tilde', 'a4')
    """
    require_kind("model", model, Model, "an instance such as Tilt(), not the class")
    chosen = as_names(model.output_names if outputs is None else outputs)
    require_known(chosen, model.output_names, "output", model.label)
    options = {"fixed": fixed or {}, "free": free, "tied": tied or {}}
    in_frequency = isinstance(model, TransferFunction) or at is not None

    if in_frequency and initial:
        raise ValueError(
            f"initial={dict(initial)} is for records; {model.label} is judged by its response: "
            "leave it out."
        )

    # The points are the same at every call: an answer must not change from run to run.
    random = np.random.default_rng(0)
    points: list[_Sensitivity] = []
    for _ in range(POINTS):
        values = {name: p.draw(random) for name, p in model.parameters.items()}
        values |= fixed or {}
        if in_frequency:
            point = _of_responses(model, chosen, values, at or {}, options, random)
        else:
            point = _of_record(model, chosen, values, initial or {}, options, random)
        if point is not None:
            points.append(point)

    if not points:
        raise ValueError(
            f"{model.label} is finite at none of {POINTS} points of its start boxes: narrow "
            "`starts` of the parameters, or declare `state_starts`, around which states are drawn."
        )

    # At a special point parameters may cancel by chance: the largest rank counts.
    fewest = min(point.seen.unseen.shape[1] for point in points)
    best, *others = [point for point in points if point.seen.unseen.shape[1] == fewest]
    names, seen = best.nlp.free, best.seen
    groups = invisible_groups(seen.unseen, seen.size, names, [best.initial])
    directions = replace(seen, elsewhere=others[0].seen if others else None)
    units = [best.nlp.problem.parameters[name].unit for name in names]
    judged = identifiability(names, units, directions, ())
    lost = {name for group in groups for name in group.names}
    reasons = dict.fromkeys(limited_parameters(model), BEYOND_A_SWITCH)
    reasons |= dict.fromkeys(switching_parameters(model), IN_A_SWITCH)
    return StructuralIdentifiability(
        model=model.label,
        names=names,
        groups=groups,
        combinations=tuple(c.formula for c in judged.combinations if set(c.names) <= lost),
        data=f"the {'response' if in_frequency else 'time history'} of {listed(chosen)}",
        reasons={name: reason for name, reason in reasons.items() if name in lost},
    )


@frozen
class _Sensitivity:
    """Sensitivity of the measurements to the free parameters at one point.

    Attributes
    ----------
    nlp : CompiledProblem
    seen : KnownDirections
        The directions that data would determine.
    initial : mapping of state to (stretches, p) array
        Sensitivity of the initial states to the parameters, in units of the change of a state that
        is visible in the data.
    """

    nlp: CompiledProblem
    seen: KnownDirections
    initial: Mapping[str, Array]


def _directions(x: Array, jacobian: Array, reach: Array) -> KnownDirections:
    """Return the directions that data would determine, from the Jacobian (rows, p) at x (p,).

    `reach` (p,) are the norms of its columns at known initial states.
    """
    size = 1 / positive_or_one(reach)
    _, singular, rows = np.linalg.svd(jacobian * size)
    # In 23 structures of the literature at four points each, directions without an effect have
    # singular values of at most 6e-15, all others at least 1e-5, with columns of unit length.
    rank = np.sum(singular > 1e-10)
    scaled = rows[:rank] * size
    weight = (1e-12 / singular[:rank, None]) ** 2
    return KnownDirections(scaled.T @ (weight * scaled), rows[rank:].T, size, x)


def _of_responses(
    model: Model,
    outputs: Sequence[str],
    values: Values,
    at: Values,
    options: Mapping[str, Any],
    random: np.random.Generator,
) -> _Sensitivity | None:
    """Return the sensitivity of the responses of all pairs; None if not finite."""
    responses = []
    low, high = np.log(BAND)
    for input in model.input_names or ("",):
        for output in outputs or ("",):
            # Every pair has other frequencies, so that not all of them miss a narrow resonance.
            omega = np.sort(np.exp(random.uniform(low, high, FREQUENCIES)))
            ones = np.ones(FREQUENCIES, dtype=complex)
            responses.append(FrequencyResponse(omega, ones, input, output))

    criterion = SquaredRelativeError("model")
    stated = several(model, responses, criterion=criterion, at=at, **options)
    nlp = compile_problem(stated)
    x = array_of(values, nlp.free)
    # A response of zero at all frequencies would count every parameter as lost.
    _, seen = nlp.responses(nlp.all_values(x)[:, None], nlp.data)
    if not (all_finite(seen) and np.any(seen)):
        return None
    jacobian = np.vstack([part.jacobian for part in informations(nlp, x)])[:, : len(x)]
    return _Sensitivity(nlp, _directions(x, jacobian, np.linalg.norm(jacobian, axis=0)), {})


@np.errstate(all="ignore")  # a structure may be far from where its formulas are finite
def _of_record(
    model: Model,
    outputs: Sequence[str],
    values: Values,
    initial: Mapping[str, Any],
    options: Mapping[str, Any],
    random: np.random.Generator,
) -> _Sensitivity | None:
    """Return the sensitivity of a record with random inputs; None if not finite."""
    # Random inputs excite everything. Gaps make stretches, each from unknown initial states.
    time, gaps = _times(model, values, random)
    shape = random.normal(size=(len(model.input_names), len(time)))
    measured = random.normal(size=(len(outputs), len(time)))
    # A given noise keeps the estimated variance from depending on the random outputs.
    criterion = OutputError(noise=dict.fromkeys(outputs, 1.0), initial=initial, inputs="held")

    for size, share in TRIALS:
        signals = dict(zip(model.input_names, size * shape, strict=True))
        signals |= dict(zip(outputs, measured, strict=True))
        signals = {name: np.where(gaps, np.nan, values) for name, values in signals.items()}
        record = Record(share * time, signals, name="random inputs", has_time=not model.is_static)
        nlp = compile_problem(Problem(model, record, criterion, **options))
        x = array_of(values, nlp.free)
        [part] = nlp.parts_of(RecordPart)
        p = [values[name] for name in model.parameters]
        starts = part.system.starts(p).full().ravel()
        nodes = starts + size * random.normal(size=(part.data.segments, part.states))
        trajectory = part.trajectory(nlp.scaling.to_solver(x), nodes, simulated=True)
        # In SI units larger states are hardly plausible; pressures are larger with any input.
        is_last = (size, share) in TRIALS[len(SIZES) - 1 :]
        if trajectory.finite and (is_last or np.all(np.abs(trajectory.states) < 30.0)):
            break
    else:
        return None

    slopes = sensitivity(part, trajectory, np.eye(len(part.outputs)))
    by_parameters = part.data.unpadded(slopes.weighted)
    by_states = part.data.unpadded(slopes.by_initial)
    rows = []
    for J, S in zip(by_parameters, by_states, strict=True):
        jacobian = J.mT.reshape(-1, J.shape[1])
        initial_jacobian = S.mT.reshape(-1, S.shape[1])
        # An orthogonal basis removes the effect of the initial states. With the normal equations of
        # a fit, directions with 1e-5 of the effect of the others could not be distinguished from
        # rounding.
        rows.append(beside(jacobian, initial_jacobian))

    scale = nlp.scaling.slope(x)
    initial_slopes = {state: slope * scale for state, slope in slopes.initial.items()}
    directions = _directions(x, np.vstack(rows) * scale, slopes.reach * scale)
    return _Sensitivity(nlp, directions, initial_slopes)


@one_thread_at_a_time
def _times(model: Any, values: Values, random: np.random.Generator) -> tuple[Array, BoolArray]:
    """Return uniform times that suit the poles of the model, and the gaps among them."""
    n = len(model.states)
    step = 1.0
    length = 240 // STRETCHES  # samples of the record that is simulated
    if n:
        p = [values[name] for name in model.parameters]
        # Not at zero itself, where the slope of a kink such as |v| v vanishes.
        state_starts = dynamics(model).starts(p).full().ravel()
        x = state_starts + 0.1 * random.normal(size=n)
        A, *_ = jacobians(model)(p, x, np.zeros(len(model.input_names)))
        poles = np.linalg.eigvals(np.nan_to_num(A.full()))
        fastest = max(float(np.abs(poles).max()), 1e-3)
        step = 0.3 / fastest
        growing = float(poles.real.max(initial=0.0))
        if growing > 0:
            # The fastest growing mode grows by at most e⁵, 150, over a stretch.
            length = int(np.clip(5.0 / growing / step, 2 * n + 4, length))

    gaps = np.arange(STRETCHES * (length + 1)) % (length + 1) == length
    return step * np.arange(gaps.size), gaps
