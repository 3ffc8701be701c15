"""A part as a regression of its residuals on what the model has and on what it may lack."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from greybox.assessment.largest_deviation import SIZE, largest_deviation
from greybox.assessment.misfit import FALSE_ALARMS, Cause
from greybox.assessment.missing_terms import (
    SMOOTH,
    Constants,
    Term,
    signals_of_record,
    terms_of_response,
)
from greybox.data.files.arrays import (
    Array,
    BoolArray,
    ComplexArray,
    IntArray,
    real_and_imaginary,
    sum_of_squares,
)
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.disturbances import UNSTABLE, DisturbedRecord
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.record_sensitivity import sensitivity
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.compiled.transient_part import Along, TransientPart
from greybox.statistics.autoregressive_likelihood import Outputs
from greybox.statistics.beta_share import chance
from greybox.statistics.column_space import column_basis, outside
from greybox.statistics.score_statistics import score_tests

TINY = 1e-300
STEP = 1e-6  # of the numbers of a term, for derivatives
# Samples of an output in a stretch: of fewer, straight lines and an autoregression leave nothing.
FEWEST = 8

Key = tuple[tuple[str, str, str], int]  # the family of a term, and its number in it


@frozen
class Regression:
    """A part as a regression of its residuals on the parameters of the fit and on missing terms.

    All columns have N rows; `changes` returns those (N, c) of terms. `again` returns the residuals
    and slopes (N, 1 + d + q) of a response at changes (d,) of the parameters, multiplied by the
    first of (1 + q, n) factors; the others are those at the next numbers of a term. `outputs` has
    the rows of every output of a record, by stretches, and `signals` returns those over which the
    shape of a term is drawn. All columns have `lost` this many degrees of freedom.

    The rows of a response or a manoeuvre are so many `pieces`, in which neighbors may be
    correlated. A manoeuvre has `known` columns (N, e) of its own: what is fitted beside the
    parameters. Below the probability `level`, the model does not explain the part.
    """

    measured: Array
    residuals: Array
    fitted: Array
    terms: Mapping[Key, Term]
    changes: Callable[[Sequence[Term]], Array]
    again: Callable[[Array, ComplexArray], Array] | None = None
    outputs: Outputs = ()
    causes: Sequence[Cause] = ()
    is_unstable: bool = False
    known: Array | None = None
    lost: int = 0
    pieces: int = 2
    level: float = FALSE_ALARMS
    signals: Callable[[], Mapping[str, Array]] = dict

    def columns(self, terms: Sequence[Term | None]) -> Array:
        """Return the columns (N, c) of terms, zero in the place of those that are missing."""
        present = [k for k, term in enumerate(terms) if term]
        values = np.zeros((len(terms), len(self.residuals)))
        if present:
            values[present] = self.changes([*filter(None, terms)]).T
        # Samples of a column are neighbors in memory, as filters need them.
        return values.T

    def on_knots(self, key: Key, signal: Array, at: Array) -> list[Term | None]:
        """Return c functions of a signal in the place of a term, None if this part lacks the term.

        Each is one at one of c knots, and linear in between.
        """
        term = self.terms.get(key)
        hats = np.eye(len(at))
        return [term and replace(term, values=np.interp(signal, at, hat)) for hat in hats]


def regression_of_record(
    record: DisturbedRecord,
    constants: Constants,
    terms: Iterable[Term],
    by_x: Array,
    is_new: Array,
    count: int,
) -> Regression:
    """Return the regression of one of `count` records.

    It is that of the new samples (outputs, samples) on the q parameters that move; `by_x` (q, p)
    are the derivatives of the solver's variables by them.
    """
    part, weight, data = record.part, record.weight, record.part.data
    slopes = sensitivity(part, record.trajectory, weight)
    noise = np.linalg.inv(weight.T @ weight)
    counts = np.sum(record.present, axis=1, keepdims=True)
    is_tested = is_new * (counts >= FEWEST * len(data.stretches))
    present = [row > 0 for row in data.unpadded(record.present * is_tested)]

    def by_stretch(values: Array) -> Sequence[Array]:
        return [
            np.where(measured.T[..., None], weight @ piece.transpose(2, 0, 1), 0.0).reshape(
                measured.size, -1
            )
            for piece, measured in zip(data.unpadded(values), present, strict=True)
        ]

    def followed(terms: Sequence[Term]) -> Array:
        return record.followed_by([(term.place, term.values) for term in terms if term.place])

    by_initial = np.einsum("ab,bmn->amn", noise, slopes.by_initial)
    starts = [*map(column_basis, by_stretch(by_initial))]
    # A wrong initial state is a cause of its own, beside which all terms are tested. An offset or a
    # trend cannot be distinguished from a drift of the errors.
    is_initial = [term.kind == "initial" for term in constants.terms]
    known = by_stretch(constants.effects[:, is_initial])
    drifts = [
        column_basis(np.hstack(each))
        for each in zip(starts, known, map(_lines, present), strict=True)
    ]

    def rows(values: Array, taken: Sequence[Array] = drifts) -> Array:
        # The initial states and straight lines of every stretch are fitted first.
        return np.vstack([*map(outside, by_stretch(values), taken)])

    by_parameters = np.einsum("ab,bpn->apn", noise, by_x @ slopes.weighted)
    with_effects = np.hstack([record.residuals[:, None], constants.effects])
    firsts = np.cumsum([0, *(row.size for row in present)])
    outputs = [
        [
            first + k + len(row) * places
            for first, row in zip(firsts, present, strict=False)
            for places in _between_gaps(row[k])
        ]
        for k in range(len(present[0]))
    ]
    return Regression(
        rows(
            (record.outputs / record.spread + record.residuals)[:, None],
            [column_basis(_lines(row)) for row in present],
        ),
        rows(record.residuals[:, None]),
        rows(by_parameters),
        _numbered(terms),
        lambda terms: rows(followed(terms)),
        outputs=outputs,
        causes=[
            *_offsets(
                constants.terms,
                rows(with_effects, starts),
                rows(by_parameters, starts),
                len(present[0]),
                count,
            )
        ],
        is_unstable=record.growth > UNSTABLE,
        lost=sum(basis.shape[1] for basis in drifts),
        signals=partial(signals_of_record, record),
    )


def _between_gaps(measured: BoolArray) -> list[IntArray]:
    """Return the places of measured samples (n,), by pieces between the longest gaps.

    Slow errors jump over a long gap, and the jumps would look like a missing term: of right models
    with four gaps of 5 to 30 samples in slow errors, half were called wrong. Every piece loses its
    first samples: on average one has 80 at least.
    """
    places = np.flatnonzero(measured)
    steps = np.diff(places)
    longest = np.sort(np.argsort(-steps, kind="stable")[: len(places) // 80])
    # An output with a rate of its own has no gaps.
    is_gap = steps[longest] * len(places) > 2 * len(measured)
    return np.split(places, 1 + longest[is_gap])


def _offsets(
    terms: Sequence[Term], columns: Array, fitted: Array, outputs: int, count: int
) -> Iterator[Cause]:
    """Yield the constants that residuals follow, judged by their slow errors.

    These look like a constant, too, but then pieces of the record differ as much. A constant that
    one piece alone determines, such as one before a step, cannot be distinguished from them. A
    random walk from zero has an offset of p < 0.001 in one of 2000 simulated records, and each of
    `count` records may have one. The first of the columns (N, 1 + c) has the residuals, and the
    others the effects of the terms. What the parameters explain is removed from both: if a gain
    compensates for a constant, the residuals do not look like a constant.
    """
    basis = column_basis(fitted)
    tests = score_tests(columns[:, 0], basis, columns[:, 1:]).T.tolist()
    columns = outside(columns, basis)
    pieces = np.arange(len(columns)) * 10 // len(columns)  # whose means show an offset
    # The numbers of a sample, one for each of the outputs, follow one another.
    firsts = outputs * (np.arange(1, 10) * len(columns) // (10 * outputs))
    for term, (decrease, p_one, value, _), column in zip(terms, tests, columns.T[1:], strict=True):
        if np.isnan(p_one):
            continue
        squares = np.bincount(pieces, column**2)
        if term.kind == "initial":
            # An autoregression expects a transient after a few large samples, and would see none.
            # But errors follow it as much where another piece begins.
            later = [columns[k:, 0] @ column[: len(column) - k] for k in firsts]
            determined, spread = 10.0, np.linalg.norm(later) / 10
        else:
            spread = np.linalg.norm(np.bincount(pieces, column * (columns[:, 0] - value * column)))
            determined = float(squares.sum() ** 2 / (squares @ squares))
        error = determined**0.5 * float(spread / squares.sum()) + TINY
        left = 1 / (1 + (value / error) ** 2 / determined)
        p_value = min(float(count * len(terms) * chance(left, determined - 1)), 1.0)
        share = decrease / len(columns)
        yield Cause(*term.described(value, error), value, error, share, p_value, p_value)


def _lines(measured: BoolArray) -> Array:
    """Return a constant and a straight line (n k, 2 k) for every output of a stretch (k, n)."""
    outputs, samples = measured.shape
    line = np.vander(np.linspace(-1, 1, samples), 2)
    return np.kron(line, np.eye(outputs)) * measured.T.reshape(-1, 1)


@np.errstate(all="ignore")  # by larger steps, a simulation may diverge
def shortened(part: RecordPart, trajectory: Trajectory, numbers: Sequence[int]) -> DisturbedRecord:
    """Return a record, a longer one with the first of these numbers of samples.

    Of a motion that is much slower than the samples, means of some residuals suffice, which show
    slow effects over the whole record; other records are cut to excerpts of the last number.
    """

    def chosen(shorter: RecordPart, values: Array) -> Array:
        rows = np.zeros((len(values), len(part.model.record)))
        for stretch, row in zip(part.data.stretches, part.data.unpadded(values), strict=True):
            rows[:, stretch.own_rows] = row[:, stretch.own]
        return shorter.data.at_samples(rows)

    def along(shorter: RecordPart) -> Trajectory:
        states = chosen(shorter, part.segments.in_order(trajectory.states))
        nodes = states[:, :: shorter.data.segment_length].T
        return shorter.trajectory(trajectory.z, nodes)

    outputs = part.simulated_outputs(trajectory)
    residuals = part.with_outputs(part.data.unpadded(part.data.measured - outputs)).data
    held = np.array([between.held for between in part.model.between])
    for samples in numbers:
        if part.samples <= samples:
            return DisturbedRecord(part, trajectory)
        coarse = part.with_data(residuals.averaged(-(-part.samples // samples), held))
        simulated = coarse.simulated_outputs(along(coarse))
        missed = np.std(simulated - chosen(coarse, outputs), axis=1)
        # The gains of a predictor belong to its step, and short stretches, which lose their last
        # mean, would have too few samples.
        is_long = np.mean([*map(len, coarse.data.stretches)]) - 1 >= FEWEST
        # A simulation by larger steps may miss an output by a tenth of what the term moves: so
        # little do terms differ.
        if is_long and not part.gains and np.all(missed < 0.1 * np.std(outputs, axis=1)):
            means = coarse.data.measured
            pieces = coarse.data.unpadded(means + simulated)
            for piece in pieces:
                # A mean of the few samples at the end would be early: slow errors would jump.
                piece[:, -1] = np.nan
            coarse = coarse.with_outputs(pieces)
            spread = np.nanstd(residuals.measured, axis=1) / np.nanstd(means, axis=1)
            return DisturbedRecord(coarse, along(coarse), spread[:, None])
    excerpt = part.excerpt(numbers[-1])
    return DisturbedRecord(excerpt, along(excerpt))


def is_held(free: Array) -> BoolArray:
    """Return which parameters (p,) cannot move alone in the directions (p, d) of a fit."""
    return np.linalg.norm(free, axis=1) < 1 - 1e-9


def regression_of_response(
    part: ResponsePart, values: Array, names: Sequence[str], free: Array
) -> Regression:
    """Return the regression of a response at all `values`; the fit moves along `free` (p, d)."""
    response, criterion, data = part.response(values), part.error_model, part.data
    # Where the modeled response is zero, all of the measured one is misfit.
    size = criterion.error_size(response if response.any() else data.response, data)
    if criterion.known_noise and data.dof is not None:
        # Divided by an estimated deviation, an error follows Student's t, whose tails would look
        # like a term. Its weight is that of the likelihood, about the scale of all residuals.
        scale = data.dof * criterion.noise_ratio(response, data) + TINY
        size = np.sqrt(size**2 + 2 * np.abs(data.response - response) ** 2 / scale)
    used = size > 0
    # A single outlier would look like a narrow mode.
    worst = largest_deviation(part, values, len(free))
    if worst and len(used) * worst.probability < SIZE:
        used[worst.index] = False
    order = np.argsort(data.omega, kind="stable")
    order = order[used[order]]

    def rows(columns: ComplexArray) -> Array:
        turned = columns[order] * np.exp(-1j * np.angle(response[order]))[:, None]
        return real_and_imaginary(turned / size[order, None])

    states = part.problem.model.state_names
    orders = [("own", part.name, 1.0)]
    orders += [
        ("trim" if signal in states else "schedule", signal, value)
        for signal, value in part.problem.at.items()
    ]
    # Where most of a response is left, no size or correlation of its errors excuses the model.
    path = Cause(
        f"a response of {data.output or 'the output'} to {data.input or 'the input'}",
        "a path between both, or wider bounds",
        1.0,
        0.0,
        1.0,
        0.0,
        0.0,
    )
    regression = _of_curve(
        lambda x: (part.response(x), part.sensitivity(x)),
        data.response,
        rows,
        values,
        names,
        free,
        terms=terms_of_response(*data.omega.tolist()),
        orders=orders,
    )
    is_unlike = 2 * sum_of_squares(regression.residuals) >= sum_of_squares(regression.measured)
    # Of 1614 simulated right fits, whose errors are white, correlated along frequency, or larger at
    # one end, at both ends or in a band, 2.2 % are below this probability, and of those in white
    # ones 1 %.
    return replace(regression, causes=(path,) if is_unlike else (), level=0.01)


def regression_of_manoeuvre(
    part: TransientPart,
    trajectory: Trajectory,
    values: Array,
    names: Sequence[str],
    free: Array,
) -> Regression:
    """Return the regression of a manoeuvre at all `values`; the fit moves along `free` (p, d).

    Its integrals at the lines of all outputs follow one another, as those of a response.
    """
    located, outputs = part.located(names), len(part.outputs)
    fitted: Along = trajectory.detail
    # What a model leaves out is smooth along the lines only beside the phase of the modeled output.
    turned = np.exp(-1j * np.angle(fitted.modeled))[..., None]

    def rows(columns: ComplexArray) -> Array:
        columns = columns.reshape(*turned.shape[:2], -1)
        weighted = np.einsum("ka,lab,blc->klc", fitted.weight, fitted.transform, columns)
        return real_and_imaginary(weighted * turned, 1).reshape(2 * turned.size, -1)

    def curve(x: Array) -> tuple[ComplexArray, ComplexArray]:
        parameters, slopes = located(x)
        at = part.along(parameters.full().ravel())
        if at is None:
            raise np.linalg.LinAlgError
        return at.modeled.ravel(), part.modeled_slopes(at, slopes.full()).reshape(-1, len(x))

    omega = np.tile(part.data.omega, outputs)
    # In turbulence, lines are larger here and there, which looks like a mode or a step.
    terms = [term for term in terms_of_response(*omega.tolist()) if term.kind in SMOOTH]
    if outputs > 1:
        late = np.repeat(np.eye(outputs), len(part.data), 1) * -1j * omega
        terms += [Term("sensor", row, b=b) for b, row in zip(part.outputs, late, strict=True)]
    regression = _of_curve(
        curve,
        part.measured.ravel(),
        rows,
        values,
        names,
        free,
        terms=terms,
        orders=[("own", part.name, 1.0)],
    )
    # The drift of an output leaves what a straight line would.
    lines = np.eye(outputs)[:, None] / (1j * part.data.omega[:, None])
    ends = fitted.to_outputs[:, :, : len(part.states)].swapaxes(0, 1)
    return replace(regression, known=rows(np.concatenate([ends, lines], 2)), pieces=2 * outputs)


def _of_curve(
    curve: Callable[[Array], tuple[ComplexArray, ComplexArray]],
    measured: ComplexArray,
    rows: Callable[[ComplexArray], Array],
    values: Array,
    names: Sequence[str],
    free: Array,
    *,
    terms: Iterable[Term],
    orders: Sequence[tuple[str, str, Any]],
) -> Regression:
    """Return the regression of a measured curve (n,) over frequency, which has `terms` to try.

    The function `curve` returns the modeled one at all values x (k,), with its derivatives (n, k);
    `rows` returns real rows of columns (n, c), in which errors are alike. Values may depend on what
    `orders` lists, as kinds of terms with a name and the number that grows.
    """
    places, p = np.flatnonzero(~is_held(free)), len(free)

    def modeled(x: Array) -> tuple[ComplexArray, ComplexArray]:
        # Where a response is zero, the effects of its parameters are not.
        model, slopes = curve(x)
        # In place of a modeled response of zero, since the square of its effects is zero.
        return np.where(model == 0, 1e-200, model), slopes

    def again(change: Array, factors: ComplexArray) -> Array:
        x = values.copy()
        x[:p] += free @ change
        model, slopes = modeled(x)
        by_term = model * (factors[1:] - factors[0]) / STEP
        columns = -np.vstack([(slopes[:, :p] @ free).T * factors[0], by_term])
        return rows(np.column_stack([measured - model * factors[0], *columns]))

    model, slopes = modeled(values)
    relative = slopes / model[:, None]
    own = [
        Term(kind, column * value, a=name, b=b)
        for k, (name, column) in enumerate(zip(names, relative.T, strict=True))
        for kind, b, value in (
            orders if k in places else [("bound" if k < p else "fixed", "", 1.0)]
        )
    ]
    residuals = rows((measured - model)[:, None])
    return Regression(
        rows(measured[:, None]),
        residuals,
        rows(-slopes[:, :p] @ free),
        _numbered([*terms, *own]) if residuals.size else {},
        lambda terms: rows(np.column_stack([model * term.values for term in terms])),
        again if residuals.size else None,
    )


def _numbered(terms: Iterable[Term]) -> dict[Key, Term]:
    """Return terms by their family and their number in it, the same in all parts."""
    numbered: dict[Key, Term] = {}
    counts = Counter[Any]()
    for term in terms:
        numbered[term.family, counts[term.family]] = term
        counts[term.family] += 1
    return numbered
