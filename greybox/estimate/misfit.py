"""Whether a model explains its data, and if not, what it may lack."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.disturbances import DisturbedRecord
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.record_sensitivity import sensitivity
from greybox.compiled.response_part import ResponsePart
from greybox.estimate.diagnostics.outlying_points import SIZE, largest_deviation
from greybox.estimate.missing_terms import (
    Term,
    constants_of_record,
    signals_of_record,
    terms_of_record,
    terms_of_response,
)
from greybox.estimate.repeated_inputs import repeated_residuals
from greybox.files.arrays import Array, BoolArray, ComplexArray, frozen, real_and_imaginary
from greybox.files.html_text import Printed
from greybox.files.text_table import number, percent, some, text_table, with_error
from greybox.modeling.added_terms import Formula
from greybox.statistics.autoregressive_test import (
    Outputs,
    autoregressive_p_values,
    whitened,
    whitening_filters,
)
from greybox.statistics.column_space import (
    DEPENDENT,
    beside,
    column_basis,
    outside,
    triangle_of,
)
from greybox.statistics.score_test import (
    REMAINS,
    chance,
    correlated_fits,
    p_values_of_fits,
    score_tests,
)

# Largest probability at which a model is called wrong. Of 959 right fits of simulated records,
# 0.6 % are below it; below 0.01 would be 2 %.
FALSE_ALARMS = 0.003
# The same of responses: of 1614 simulated right fits, whose errors are white, correlated along
# frequency, or larger at one end, at both ends or in a band, 2.2 % are below it, and of those in
# white ones 1 %.
OF_RESPONSES = 0.01
CONDITIONAL = 0.001  # the same where correlated errors of a response would excuse the model
POSSIBLE = 0.05  # and where drift alone would
NAMED = 3  # causes that are printed with a fit
# Terms that together explain all of the misfit: more would fit noise.
TOGETHER = 5
# Correlation time of the residuals, as in tanks that overflow or a drive with friction: sensors are
# seldom so slow. And of the output, what a reader would see.
DRIFTING, NOTICED = 0.99, 0.01
LARGE = 10  # times what noise leaves, beyond which a model describes nothing
NOISY = 0.25  # of the variance: residuals of half the standard deviation of an output
TINY = 1e-300
# Samples of all records that are tested, in excerpts: with more, a fit would wait for the test.
MOST = 3000
FEWEST = 500  # of each
STEP = 1e-6  # of the numbers of a term, for derivatives
KNOTS = 11  # of the shape of a term over a signal

Key = tuple[tuple[str, str, str], int]  # the family of a term, and its number in it
Block = tuple[Array, Array, Sequence[int]]  # see `correlated_fits`
Stack = tuple[Array, Array, Outputs, list[Array]]  # see `_stacked`


@dataclass(frozen=True)
class Cause:
    """A term that the model may lack.

    Attributes
    ----------
    text, code : str
        What it is, and how the model gets it.
    value, error : float
        The factor on the term that a fit would estimate, to first order, and its standard error.
    share : float
        Share of the misfit that it explains, to first order, as far as earlier samples do not
        predict it. Where the misfit of records is far above the noise, the share of all of it
        counts if that is larger.
    p_value : float
        Probability of such a share if the model explains the data, times the number of terms that
        were tried for records; for responses that of terms of its kind, times the number of kinds.
    p_correlated : float
        The same if errors of neighboring points of a response may be correlated.
    alike : tuple of str
        Terms that have nearly the same effect, so that the data cannot tell them apart.
    added : (str, Formula) or None
        The state to whose derivative it adds, and the unit term; not stored with a fit.
    """

    text: str
    code: str
    value: float
    error: float
    share: float
    p_value: float
    p_correlated: float
    alike: tuple[str, ...] = ()
    added: tuple[str, Formula] | None = field(
        default=None, compare=False, metadata={"stored": False}
    )

    @property
    def remedy(self) -> str:
        """The term with its test, how the model gets it, and what it cannot be told apart from."""
        test = f"({percent(self.share)} % of the misfit, {_chance(self.p_value)})"
        also = f"; hardly distinct from {some(self.alike)}" if self.alike else ""
        return f"to add: {self.text} {test}{': ' * bool(self.code)}{self.code}{also}"


@dataclass(frozen=True)
class Shape:
    """How the term that explains most depends on a signal, beside what the parameters explain.

    Attributes
    ----------
    text, signal : str
        The term in words, and the state, input, rate of an input, or time, over which the
        residuals show it most clearly.
    at : tuple of float
        Values of the signal.
    values, errors : tuple of float
        What the model lacks there in the place of the term, such as the equation of a state,
        whatever its form, and its standard errors.
    by_term : tuple of float
        The same if the term is all that is missing.
    """

    text: str
    signal: str
    at: tuple[float, ...]
    values: tuple[float, ...]
    errors: tuple[float, ...]
    by_term: tuple[float, ...]


@dataclass(frozen=True)
class Misfit(Printed):
    """Whether a model explains its data, and what it may lack. It prints itself.

    Attributes
    ----------
    left, noise : float
        Share of the squares of the outputs about straight lines that the model leaves, and that
        noise would leave; of responses, relative to the sizes of their errors. They are those of
        the output of a record, or of the responses, where both differ most.
    tried : int
        Number of terms.
    causes : tuple of Cause
        The best term of every family; the one that explains most comes first.
    p_common : float
        Probability of such residuals of several responses if one set of values serves all.
    drift : float
        Share of the squares of the residuals of records that earlier samples predict.
    is_unstable : bool
        Whether the model is unstable, so that the inputs of a record answer to its errors.
    shape : Shape or None
        The shape of the best term of records, where it is significant.
    level : float
        Probability below which the model does not explain the data.
    """

    left: float
    noise: float
    tried: int
    causes: tuple[Cause, ...]
    p_common: float
    drift: float
    is_unstable: bool
    shape: Shape | None = None
    level: float = FALSE_ALARMS

    @property
    def p_value(self) -> float:
        """Probability of such residuals if the model explains the data."""
        # Several responses test two hypotheses: common values, and missing terms.
        tests = 1 + (self.p_common < 1)
        return min(
            tests * min([self.p_common, *(cause.p_correlated for cause in self.causes)]), 1.0
        )

    @property
    def explains(self) -> bool:
        """Whether the residuals look like noise."""
        return not self.p_value < self.level

    @property
    def is_large(self) -> bool:
        """Whether the model leaves more than ten times what noise would."""
        return not self.explains and self.left > LARGE * self.noise

    @property
    def likely(self) -> tuple[Cause, ...]:
        """The causes that are named: up to three, where the model may not explain the data."""
        excused = POSSIBLE if self.is_drifting else CONDITIONAL
        limit = excused if self.explains else self.level
        return tuple([cause for cause in self.causes if cause.p_value < limit][:NAMED])

    @property
    def is_drifting(self) -> bool:
        """Whether large, slow residuals are all that is wrong, and no term is certain."""
        return self.explains and self.drift > DRIFTING and self.left > NOTICED

    @property
    def verdict(self) -> str:
        """Whether the model explains the data, in a few words."""
        left = f"{percent(self.left)} % of their variance is left and follows"
        noise = f"; noise alone would leave about {percent(self.noise)} %"
        noise *= self.noise < self.left
        if self.is_drifting:
            return (
                f"explains the data only if errors drift: {left} from earlier samples, but for "
                f"certain from none of {self.tried} missing terms"
            )
        if self.explains and self.likely:
            return (
                "explains the data only if errors of neighboring points are correlated, or larger "
                f"at one end: otherwise, {left} what drove the test{noise}"
            )
        if self.explains:
            size = f" ({percent(self.left)} % of the variance)" * (self.left > NOISY)
            return (
                f"explains the data: the residuals{size} follow none of {self.tried} missing terms"
            )
        common = self.p_common < self.level
        return (
            f"does not explain the data: {left} what drove the test ({_chance(self.p_value)})"
            f"{noise}{'; one set of values does not serve all parts' * common}"
        )

    def __str__(self) -> str:
        header = ["term", "factor", "± error", "explains", "p", "how to add it"]
        rows = [
            [
                cause.text,
                *with_error(cause.value, cause.error),
                f"{percent(cause.share)} %",
                number(cause.p_value, 2),
                cause.code,
            ]
            for cause in self.causes
        ]
        return f"The model {self.verdict}.\n\n{text_table(header, rows, (0, 5))}"


@frozen
class _Regression:
    """A part as a regression of its residuals on the parameters of the fit and on missing terms.

    All columns have N rows; `changes` returns those (N, c) of terms. `again` returns the residuals
    and slopes (N, 1 + d + q) of a response at changes (d,) of the parameters, multiplied by the
    first of (1 + q, n) factors; the others are those at the next numbers of a term. `outputs` has
    the rows of every output of a record, by stretches, and `signals` returns those over which the
    shape of a term is drawn. What parameters leave of a term is an error of the integration if it
    is less than `remains` of it. All columns have `lost` this many degrees of freedom.
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
    remains: float = REMAINS
    lost: int = 0
    signals: Callable[[], Mapping[str, Array]] = dict

    def columns(self, keys: Sequence[Key]) -> Array:
        """Return the columns (N, c) of terms, zero for those that this part does not have."""
        present = [k for k, key in enumerate(keys) if key in self.terms]
        values = np.zeros((len(keys), len(self.residuals)))
        if present:
            values[present] = self.changes([self.terms[keys[k]] for k in present]).T
        # Samples of a column are neighbors in memory, as filters need them.
        return values.T


def assessed_misfit(
    nlp: CompiledProblem,
    x: Array,
    trajectories: Sequence[Trajectory],
    at_bound: Sequence[str],
    candidates: Mapping[str, Formula],
) -> Misfit | None:
    """Return whether a model explains its data at `x` (p,); None where that cannot be decided.

    Parameters that a bound holds, `at_bound`, absorb nothing. `candidates` has the terms of the
    user.
    """
    responses, records = [], []
    moves = ~np.isin(nlp.free, at_bound)
    for part, trajectory in zip(nlp.parts, trajectories, strict=True):
        if isinstance(part, ResponsePart):
            responses.append(_of_response(part, nlp.all_values(x), nlp.names, moves))
        elif isinstance(part, RecordPart) and part.model.has_time and not part.model.is_prior:
            records.append((part, trajectory))

    # Each record has its part of the samples.
    most = max(MOST // max(len(records), 1), FEWEST)
    disturbed = [
        DisturbedRecord(*_on_excerpts(part, trajectory, most)) for part, trajectory in records
    ]
    regressions = [
        _of_record(
            record,
            [*terms_of_record(record, at_bound, candidates), *terms],
            # Records are linearized by the solver's variables, responses by the parameters.
            np.diag(nlp.scaling.slope(x))[moves],
            is_new,
            len(records),
        )
        for record, (terms, is_new) in zip(disturbed, repeated_residuals(disturbed), strict=True)
    ]
    tested = [group for group in (responses, regressions) if any(part.terms for part in group)]
    stacks = [*map(_stacked, tested)]
    groups = [*map(_of_group, tested, stacks, _determined(stacks))]
    if all(group.explains and not group.tried for group in groups):
        return None

    # What explains most comes first, among what is significant, and what has no known form last.
    # The best stands for equal texts.
    best = dict[str, Cause]()
    for group in groups:
        for cause in group.causes:
            best.setdefault(cause.text, cause)
    # Rounding must not order what explains as much.
    causes = sorted(
        best.values(), key=lambda c: (c.p_value >= FALSE_ALARMS, not c.code, -round(c.share, 9))
    )
    return replace(
        max(groups, key=lambda group: group.left - group.noise),
        tried=sum(group.tried for group in groups),
        causes=tuple(causes),
        p_common=min(group.p_common for group in groups),
        shape=groups[-1].shape,
        level=groups[-1].level,
    )


def _stacked(parts: Sequence[_Regression]) -> Stack:
    """Return residuals (N, 1), columns (N, d), rows of all outputs, and their whitening filters."""
    residuals = np.vstack([part.residuals for part in parts])
    fitted = np.vstack([part.fitted for part in parts])
    firsts = np.cumsum([0, *(len(part.residuals) for part in parts)])
    outputs = [
        [first + rows for rows in stretches]
        for first, part in zip(firsts, parts, strict=False)
        for stretches in part.outputs
    ]
    return residuals, fitted, outputs, whitening_filters(residuals[:, 0], outputs)


def _determined(stacks: Sequence[Stack]) -> list[Array]:
    """Return the combinations (d, k) of d parameters that each group may change.

    Combinations that the other group knows much better cannot excuse a misfit.
    """
    if len(stacks) < 2:
        return [np.eye(fitted.shape[1]) for _, fitted, *_ in stacks]
    rows = []
    for residuals, fitted, outputs, filters in stacks:
        both = whitened(np.hstack([residuals, fitted]), filters, outputs)
        rows.append(both[:, 1:] / (np.sqrt(np.mean(both[:, 0] ** 2)) + TINY))
    # In directions that both determine equally well, whatever the units.
    unit = np.linalg.pinv(triangle_of(np.vstack(rows)))
    pairs = [np.linalg.svd(each @ unit, full_matrices=False)[1:] for each in rows]
    # Where a group has less than a tenth of the information, the other one knows the values.
    return [unit @ axes[share**2 > 0.1].T for share, axes in pairs]


def _of_group(parts: Sequence[_Regression], stack: Stack, determined: Array) -> Misfit:
    """Return the misfit of all records or of all responses, in which a term is missing alike.

    The columns of `determined` (d, k) are what its fit can change.
    """
    # With two parts, either one may need another value; a single part has no counterpart.
    either = parts[0].terms if len(parts) < 3 and np.equal(*determined.shape) else {}
    terms = {
        key: term
        for part in parts
        for key, term in part.terms.items()
        if term.kind != "own" or key not in either
    }
    residuals, fitted, outputs, filters = stack
    fitted = fitted @ determined
    white = partial(whitened, filters=filters, outputs=outputs)
    white_residuals, white_fitted = white(residuals), white(fitted)
    tried, ranked = _ranked(parts, [*terms], white, white_residuals[:, 0], white_fitted)
    best_columns = np.hstack([residuals[:, :0], *(column for *_, column in ranked)])
    white_best = white(best_columns)
    together = np.hstack([fitted, best_columns[:, :TOGETHER]])
    without, remainder = (
        float(np.sum(beside(white_residuals, columns) ** 2))
        for columns in (white_fitted, np.hstack([white_fitted, white_best[:, :TOGETHER]]))
    )
    explained = len(white_residuals) * (1 - remainder / (without + TINY)) + TINY
    left, noise = _shares(parts, (residuals, beside(residuals, together)), outputs)
    shares = [decrease / explained for (decrease, *_), *_ in ranked]
    if left > LARGE * noise:
        # Residuals without noise are whitened by what the misfit is like: slow parts count little.
        alone = score_tests(residuals[:, 0], fitted, best_columns)[0] / len(residuals)
        shares = np.maximum(shares, alone).tolist()
    # Among responses, each family is as likely to be missing, whatever its number of terms.
    tests = [tried.total() if outputs else len(tried) * tried[key[0]] for _, key, _ in ranked]
    p_common = 1.0
    p_values = p_correlated = [p_value for (_, p_value, *_), *_ in ranked]
    if outputs:
        # Where records have unlike outputs, errors of outputs count as independent.
        width = len(parts[0].outputs) if len({len(part.outputs) for part in parts}) == 1 else 1
        p_values = autoregressive_p_values(
            residuals[:, 0], fitted, best_columns, outputs, width, sum(part.lost for part in parts)
        ).tolist()
        p_correlated = p_values
    elif ranked:
        block = residuals, fitted, _lengths(parts)
        p_correlated, p_common = _p_of_responses(
            parts, determined, block, best_columns, ranked, tests
        )

    texts = [terms[key].described(test[2], test[3]) for test, key, _ in ranked]
    alike = _alike(beside(white_best, white_fitted), texts)
    causes = []
    for k, ((_, _, value, error), key, _) in enumerate(ranked):
        # Errors that are correlated may hide a term, or look like one.
        p_alone = tests[k] * min(p_values[k], p_correlated[k])
        numbers = np.minimum([shares[k], p_alone, tests[k] * p_correlated[k]], 1.0).tolist()
        term = terms[key]
        added = (term.b, term.added) if term.added else None
        causes.append(Cause(*texts[k], value, error, *numbers, alike=alike[k], added=added))

    # What earlier samples do not predict.
    innovations = [len(residuals) / float(weights[0]) ** 2 for weights in filters]
    squares = float(np.sum(residuals**2)) + TINY
    return Misfit(
        left,
        noise,
        tried.total(),
        (*causes, *(cause for part in parts for cause in part.causes)),
        p_common,
        1 - min(innovations, default=squares) / squares,
        any(part.is_unstable for part in parts),
        _shape(parts, zip(ranked, causes, strict=True), white, white_residuals, white_fitted),
        FALSE_ALARMS if outputs else OF_RESPONSES,
    )


def _shares(
    parts: Sequence[_Regression], residuals: tuple[Array, Array], outputs: Outputs
) -> Sequence[float]:
    """Return the shares of the squares of the outputs that the model and noise leave."""
    measured = np.vstack([part.measured for part in parts])
    # Perhaps only one of the outputs of a record follows a missing term.
    shares = [
        [float(np.sum(e[rows] ** 2) / (np.sum(measured[rows] ** 2) + TINY)) for e in residuals]
        for rows in [*map(np.concatenate, outputs)] or [...]
    ]
    return max(shares, key=lambda pair: pair[0] - pair[1])


def _shape(
    parts: Sequence[_Regression],
    tests: Iterable[tuple[tuple[list[float], Key, Array], Cause]],
    white: Callable[[Array], Array],
    residuals: Array,
    fitted: Array,
) -> Shape | None:
    """Return the shape of the best term over the signal that explains most of residuals (N, 1)."""
    # A wrong value has no shape; the next best term shows what it stands for.
    drawn = [
        (cause, key, column)
        for (_, key, column), cause in tests
        if key[0][0] != "fixed" and cause.p_value < FALSE_ALARMS
    ]
    if not drawn:
        return None
    cause, key, column = max(drawn, key=lambda test: test[0].share)
    best, least = None, np.inf
    # A value that one record needs has no place in the others.
    terms = [part.terms[key] for part in parts if key in part.terms]
    by_part = [part.signals() for part in parts] if len(terms) == len(parts) else [{}]
    for name in by_part[0]:
        signals = [of_part[name] for of_part in by_part]
        knots = np.linspace(np.min(np.hstack(signals)), np.max(np.hstack(signals)) + TINY, KNOTS)
        hats = np.eye(KNOTS)
        columns = [
            part.changes([replace(term, values=np.interp(row, knots, hat)) for hat in hats])
            for part, term, row in zip(parts, terms, signals, strict=True)
        ]
        # What the parameters explain is determined neither here nor in the shape of the term, nor
        # are knots with too few samples.
        effects = beside(white(np.vstack(columns)), fitted)
        inverse = np.linalg.pinv(effects, rcond=0.02)
        values = inverse @ residuals
        size = float(np.std(residuals - effects @ values))
        if size < least:
            errors = size * np.linalg.norm(inverse, axis=1)
            by_term = inverse @ beside(white(cause.value * column), fitted)
            rows = (np.ravel(row).tolist() for row in (knots, values, errors, by_term))
            best, least = Shape(cause.text, name, *map(tuple, rows)), size
    return best


def _alike(effects: Array, texts: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return for every term those whose effects (N, c) are nearly the same."""
    unit = effects / np.linalg.norm(effects, axis=0)
    is_alike = np.abs(unit.T @ unit) - np.eye(len(texts)) > 0.95
    return [tuple(texts[j][0] for j in np.flatnonzero(row).tolist()) for row in is_alike]


def _ranked(
    parts: Sequence[_Regression],
    keys: list[Key],
    white: Callable[[Array], Array],
    residuals: Array,
    fitted: Array,
) -> tuple[Counter[Any], list[tuple[list[float], Key, Array]]]:
    """Return the number of terms by family, and the best of each with its test and its column.

    `residuals` (N,) and `fitted` (N, p) are white.
    """
    best, tried = {}, Counter[Any]()
    remains = min(part.remains for part in parts)
    # With all 1059 terms of a chain of eight states in memory at once, a test takes a quarter more
    # time and 370 MB.
    size = 600_000 // (len(residuals) + 1) + 1
    for first in range(0, len(keys), size):
        chosen = keys[first : first + size]
        columns = np.vstack([part.columns(chosen) for part in parts])
        tests = score_tests(residuals, fitted, white(columns), remains).T.tolist()
        for k, (test, key) in enumerate(zip(tests, chosen, strict=True)):
            # The probability is NaN where nothing of a term is left.
            if test[1] <= 1:
                tried[key[0]] += 1
                if test > best.get(key[0], [[]])[0]:
                    best[key[0]] = test, key, columns[:, [k]]
    # The best twelve are tested beside the color of the errors.
    return tried, sorted(best.values(), key=lambda test: -round(test[0][0], 9))[:12]


def _numbered(terms: Iterable[Term]) -> dict[Key, Term]:
    """Return terms by their family and their number in it, the same in all parts."""
    numbered: dict[Key, Term] = {}
    counts = Counter[Any]()
    for term in terms:
        numbered[term.family, counts[term.family]] = term
        counts[term.family] += 1
    return numbered


def _of_record(
    record: DisturbedRecord, terms: Iterable[Term], by_x: Array, is_new: Array, count: int
) -> _Regression:
    """Return the regression of one of `count` records.

    It is that of the new samples (outputs, samples) on the q parameters that move; `by_x` (q, p)
    are the derivatives of the solver's variables by them.
    """
    part, trajectory = record.part, record.trajectory
    weight, data = part.residual_weight(trajectory), part.data
    slopes = sensitivity(part, trajectory, weight)
    noise = np.linalg.inv(weight.T @ weight)
    # Straight lines and an autoregression leave nothing of fewer samples of an output.
    is_tested = is_new * (np.sum(record.present, axis=1, keepdims=True) >= 8)
    present = [row > 0 for row in data.unpadded(record.present * is_tested)]

    def rows_of_stretch(values: Array, measured: BoolArray) -> Array:
        result = np.where(measured, weight @ values.swapaxes(0, 1), 0.0)
        return result.swapaxes(1, 2).reshape(len(result), measured.size).T

    by_initial = data.unpadded(np.einsum("ab,bmn->amn", noise, slopes.by_initial))
    starts = [*map(rows_of_stretch, by_initial, present)]
    # An offset or a trend cannot be distinguished from a drift of the errors.
    drifts = [
        column_basis(np.hstack(pair)) for pair in zip(starts, map(_lines, present), strict=True)
    ]
    starts = [*map(column_basis, starts)]

    def rows(values: Array, taken: Sequence[Array] = drifts) -> Array:
        stretches = map(rows_of_stretch, data.unpadded(values), present)
        # The initial states and straight lines of every stretch are fitted first.
        return np.vstack([*map(outside, stretches, taken)])

    by_parameters = np.einsum("ab,bpn->apn", noise, by_x @ slopes.weighted)
    constants = [*constants_of_record(record)]
    effects = record.followed_by(term.place(term.values) for term in constants if term.place)
    with_effects = np.concatenate([record.residuals[:, None], effects], axis=1)
    firsts = np.cumsum([0, *(row.size for row in present)])
    outputs = [
        [
            first + k + len(row) * np.flatnonzero(row[k])
            for first, row in zip(firsts, present, strict=False)
        ]
        for k in range(len(present[0]))
    ]
    offsets = _offsets(
        constants, rows(with_effects, starts), rows(by_parameters, starts), outputs, count
    )
    return _Regression(
        rows(np.nan_to_num(data.measured)[:, None], [column_basis(_lines(row)) for row in present]),
        rows(record.residuals[:, None]),
        rows(by_parameters),
        _numbered(terms),
        lambda terms: rows(record.followed_by(t.place(t.values) for t in terms if t.place)),
        outputs=outputs,
        causes=tuple(offsets),
        # A hundredfold growth of errors of the states over the record.
        is_unstable=record.growth > 4.6,
        # From known initial states, terms grow as parameters do, and differ by what does not grow.
        remains=max(REMAINS * np.exp(-record.growth * part.known_states.any()), DEPENDENT),
        lost=sum(basis.shape[1] for basis in drifts),
        signals=partial(signals_of_record, record),
    )


def _offsets(
    terms: Sequence[Term], columns: Array, fitted: Array, outputs: Outputs, count: int
) -> Iterator[Cause]:
    """Yield the constants that residuals follow, judged by their slow errors.

    These look like a constant, too, but then pieces of the record differ as much. A constant that
    one piece alone determines, as one before a step does, cannot be told from them. A random walk
    from zero has an offset of p < 0.001 in one of 2000 simulated records, and each of `count`
    records may have one. The first of the columns (N, 1 + c) has the residuals, and the others the
    effects of the terms. Both lose what the parameters take: a gain that makes up for a constant
    leaves residuals unlike one.
    """
    tests = score_tests(columns[:, 0], fitted, columns[:, 1:]).T.tolist()
    columns = beside(columns, fitted)
    pieces = np.zeros(len(columns), dtype=int)
    for rows in map(np.concatenate, outputs):
        pieces[rows] = np.arange(len(rows)) * 10 // len(rows)  # whose means show an offset
    for term, (decrease, p_one, value, _), column in zip(terms, tests, columns.T[1:], strict=True):
        if np.isnan(p_one):
            continue
        squares = np.bincount(pieces, column**2)
        spread = np.linalg.norm(np.bincount(pieces, column * (columns[:, 0] - value * column)))
        determined = float(squares.sum() ** 2 / (squares @ squares))
        error = determined**0.5 * float(spread / squares.sum()) + TINY
        left = 1 / (1 + (value / error) ** 2 / determined)
        p_value = chance(left, determined - 1)
        numbers = np.minimum(
            [decrease / len(columns), *2 * [count * len(terms) * p_value]], 1.0
        ).tolist()
        yield Cause(*term.described(value, error), value, error, *numbers)


def _lines(measured: BoolArray) -> Array:
    """Return a constant and a straight line (n k, 2 k) for every output of a stretch (k, n)."""
    outputs, samples = measured.shape
    line = np.vander(np.linspace(-1, 1, samples), 2)
    return np.kron(line, np.eye(outputs)) * measured.T.reshape(-1, 1)


def _on_excerpts(
    part: RecordPart, trajectory: Trajectory, samples: int
) -> tuple[RecordPart, Trajectory]:
    """Return a longer part on excerpts of this many samples, with its trajectory there."""
    if part.samples <= samples:
        return part, trajectory
    excerpt = part.excerpt(samples)
    states = np.zeros((part.states, len(part.model.record)))
    in_order = part.data.unpadded(part.segments.in_order(trajectory.states))
    for stretch, row in zip(part.data.stretches, in_order, strict=True):
        states[:, stretch.rows] = row

    nodes = excerpt.data.at_samples(states)[:, :: excerpt.data.segment_length].T
    return excerpt, excerpt.trajectory(trajectory.z, nodes)


def _of_response(
    part: ResponsePart, values: Array, names: Sequence[str], moves: BoolArray
) -> _Regression:
    free, places = moves.size, np.flatnonzero(moves)
    response, criterion, data = part.response(values), part.criterion, part.data
    # Of a response of zero, all is misfit.
    size = criterion.error_size(response if response.any() else data.response, data)
    if criterion.known_noise and data.dof is not None:
        # Over an estimated variance an error is Student's t, whose tails would look like a term.
        # Its weight is that of the likelihood, about the scale of all residuals.
        scale = data.dof * criterion.noise_ratio(response, data) + TINY
        size = np.sqrt(size**2 + 2 * np.abs(data.response - response) ** 2 / scale)
    used = size > 0
    # A single outlier would look like a narrow mode.
    worst = largest_deviation(part, values, free)
    if worst and len(used) * worst.probability < SIZE:
        used[worst.index] = False
    order = np.argsort(data.omega, kind="stable")
    order = order[used[order]]

    def rows(columns: ComplexArray) -> Array:
        turned = columns[order] * np.exp(-1j * np.angle(response[order]))[:, None]
        return real_and_imaginary(turned / size[order, None])

    def again(change: Array, factors: ComplexArray) -> Array:
        x = values.copy()
        x[places] += change
        model, slopes = part.response(x), part.sensitivity(x)[:, places]
        by_term = model * (factors[1:] - factors[0]) / STEP
        columns = -np.vstack([slopes.T * factors[0], by_term])
        return rows(np.column_stack([data.response - model * factors[0], *columns]))

    relative = part.sensitivity(values) / np.where(response == 0, np.inf, response)[:, None]
    states, sine = getattr(part.problem.model, "states", ()), part.problem.amplitude
    orders = [("own", part.name, 1.0)]
    orders += [
        ("trim" if signal in states else "schedule", signal, value)
        for signal, value in part.problem.at.items()
    ]
    if sine is not None:
        orders += [("amplitude", sine.signal, sine.amplitude)]
    own = [
        Term(kind, column * value, a=name, b=b)
        for k, (name, column) in enumerate(zip(names, relative.T, strict=True))
        for kind, b, value in (
            orders if k in places else [("bound" if k < free else "fixed", "", 1.0)]
        )
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
    measured, left = rows(data.response[:, None]), rows((data.response - response)[:, None])
    return _Regression(
        measured,
        left,
        rows(-part.sensitivity(values)[:, places]),
        _numbered([*terms_of_response(*data.omega.tolist()), *own]) if order.size else {},
        lambda terms: rows(np.column_stack([response * term.values for term in terms])),
        again if order.size else None,
        causes=() if np.sum(left**2) < np.sum(measured**2) / 2 else (path,),
    )


def _p_of_responses(
    parts: Sequence[_Regression],
    determined: Array,
    block: Block,
    columns: Array,
    ranked: Sequence[Any],
    tests: Sequence[int],
) -> tuple[list[float], float]:
    """Return the probabilities of terms, with columns (N, c), and of values common to all parts.

    Terms that may be significant are fitted unless they are to first order.
    """
    fits = correlated_fits([block], columns)
    p_values, p_common = p_values_of_fits(fits, fits)[1:], 1.0
    whole = np.eye(len(determined))
    if len(parts) > 1 or determined.shape != whole.shape:
        # Other values may be far from the common ones: each part is fitted by itself.
        apart = correlated_fits([_refitted([part], whole) for part in parts if part.again])
        [p_common] = p_values_of_fits(fits, apart)
    for k, (_, key, _) in enumerate(ranked):
        if OF_RESPONSES < tests[k] * p_values[k] < 1:
            again = _refitted(parts, determined, key)
            [p_value] = p_values_of_fits(fits, correlated_fits([again]))
            # A fit of q numbers stands for as many terms.
            q = again[1].shape[1] - determined.shape[1]
            p_values[k] = min(p_values[k], p_value / q)
    return p_values, p_common


def _refitted(parts: Sequence[_Regression], determined: Array, key: Any = None) -> Block:
    """Return residuals, columns and lengths of responses that are fitted again, beside a term.

    The levels of the term are fitted, too: a mode has its own frequency and damping.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415  (slow to import)

    fits = [
        (part.again, part.terms.get(key, Term("", np.zeros(1)))) for part in parts if part.again
    ]
    (d, k), start, lengths = determined.shape, fits[0][1].start, _lengths(parts)

    @lru_cache(1)
    def table(*values: float) -> Array:
        numbers = np.array(values[k:]) + STEP * np.eye(start.size + 1, start.size, -1)
        rows = np.vstack(
            [
                again(determined @ values[:k], np.array([*map(term.factor, numbers)]))
                for again, term in fits
            ]
        )
        return np.hstack([rows[:, :1], rows[:, 1 : d + 1] @ determined, rows[:, d + 1 :]])

    # A step or two suffice where values are near the common ones; of resonances a factor of 20
    # apart, p falls from 0.4 without a step to 1e-38 with five. Frequency and damping of a term
    # take ten. They end at a change of the log likelihood far below what is significant.
    values = least_squares(
        lambda values: table(*values)[:, 0],
        np.append(np.zeros(k), start),
        lambda values: table(*values)[:, 1:],  # pyright: ignore[reportArgumentType]
        x_scale="jac",
        max_nfev=10,
        ftol=0.3 / sum(lengths),
    ).x
    residuals, slopes = np.split(table(*values), [1], axis=1)
    return residuals, slopes, lengths


def _lengths(parts: Sequence[_Regression]) -> list[int]:
    """Return the numbers of real parts and of imaginary parts, which follow one another."""
    return [n // 2 for part in parts if (n := len(part.residuals)) for _ in "ri"]


def _chance(p_value: float) -> str:
    return "p < 1e-9" if p_value < 1e-9 else f"p = {p_value:.2g}"
