"""Whether a model explains its data, and if not, what it may lack."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.disturbances import DisturbedRecord
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.record_sensitivity import sensitivity
from greybox.compiled.response_part import ResponsePart
from greybox.estimate.diagnostics.outlying_points import SIZE, largest_deviation
from greybox.estimate.missing_terms import Formula, Term, terms_of_record, terms_of_response
from greybox.files.arrays import Array, BoolArray
from greybox.files.text_table import number, percent, text_table, with_error
from greybox.statistics.autoregressive_test import (
    Outputs,
    autoregressive_p_values,
    whitened,
    whitening_filters,
)
from greybox.statistics.column_space import beside, column_basis
from greybox.statistics.score_test import (
    chance,
    correlated_score,
    p_value_of_scores,
    score_tests,
)

# Share of right models that are said not to explain their data, at most: many fits are made, and
# misfits of the size of the noise have far smaller probabilities.
FALSE_ALARMS = 0.001
NAMED = 3  # causes that are printed with a fit
# Terms that together stand for all of the misfit: more would take up noise.
TOGETHER = 5
# Families of terms, the best ones, that are tested beside the color of the errors.
FAMILIES = 12
COLUMNS = 2_000_000  # numbers of all terms at once in memory, 16 MB
# Samples of all records that are tested, in excerpts: with more, a fit would wait for the test.
MOST = 3000
FEWEST = 500  # of each
REFIT = 30  # iterations of a response by itself

Numbers = NDArray[np.inexact]  # real, or complex for a response
Key = tuple[tuple[str, str, str], int]  # the family of a term, and its number in it


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
        Share of the misfit that it explains, to first order.
    p_value : float
        Probability of such a share if the model explains the data, times the number of terms that
        were tried for records, or for responses.
    p_correlated : float
        The same if errors of neighboring points of a response may be correlated.
    """

    text: str
    code: str
    value: float
    error: float
    share: float
    p_value: float
    p_correlated: float

    @property
    def explained(self) -> str:
        """The share of the misfit with the test of the term, in words."""
        return f"{_percent(self.share)} of the misfit, {_chance(self.p_value)}"


@dataclass(frozen=True)
class Misfit:
    """Whether a model explains its data, and what it may lack. It prints itself.

    Attributes
    ----------
    left, noise : float
        Share of the squares of the outputs about their means that the model leaves, and that noise
        would leave; of a response, the mean squared relative error. Of the part of the problem
        where both differ most.
    tried : int
        Number of terms.
    causes : tuple of Cause
        The best of every family of terms, the one that explains most first.
    p_common : float
        Probability of such residuals of several responses if one set of values serves all.
    """

    left: float
    noise: float
    tried: int
    causes: tuple[Cause, ...]
    p_common: float = 1.0

    @property
    def p_value(self) -> float:
        """Probability of such residuals if the model explains the data."""
        return min(self.p_common, *(cause.p_correlated for cause in self.causes), 1.0)

    @property
    def explains(self) -> bool:
        """Whether the residuals look like noise."""
        return not self.p_value < FALSE_ALARMS

    @property
    def may_be_feedback(self) -> bool:
        """Whether disturbances under feedback may look like the terms, which leave a part of it."""
        return self.explains or self.noise > 0.1 * self.left

    @property
    def likely(self) -> tuple[Cause, ...]:
        """The causes that are named: up to three, where the model may not explain the data."""
        return tuple([cause for cause in self.causes if cause.p_value < FALSE_ALARMS][:NAMED])

    @property
    def verdict(self) -> str:
        """Whether the model explains the data, in a few words."""
        if self.explains and self.likely:
            return (
                "explains the data only if errors of neighboring points are correlated, or larger "
                f"at one end: otherwise, {_percent(self.left)} of their variance is left and "
                "follows what drove the test; "
                f"noise alone would leave about {_percent(self.noise)}"
            )
        if self.explains:
            return f"explains the data: the residuals follow none of {self.tried} missing terms"
        common = self.p_common < FALSE_ALARMS
        return (
            f"does not explain the data: {_percent(self.left)} of their variance is left and "
            f"follows what drove the test ({_chance(self.p_value)}); noise alone would leave about "
            f"{_percent(self.noise)}{'; one set of values does not serve all parts' * common}"
        )

    def __str__(self) -> str:
        header = ["term", "factor", "± error", "explains", "p", "how to add it"]
        rows = [
            [
                cause.text,
                *with_error(cause.value, cause.error),
                _percent(cause.share),
                number(cause.p_value, 2),
                cause.code,
            ]
            for cause in self.causes
        ]
        return f"The model {self.verdict}.\n\n{text_table(header, rows, (0, 5))}"


@dataclass(frozen=True, eq=False)
class _Regression:
    """A part as a regression of its residuals on what the fit and missing terms take from them.

    `rows` makes columns (N, c) of values, for tests or only weighted; `changes` returns the values
    for terms; `separate` those of the residuals and of the slopes of a response that is fitted
    alone; `outputs` has the rows of every output of a record, by stretches.
    """

    measured: Numbers
    residuals: Numbers
    fitted: Numbers
    terms: Mapping[Key, Term]
    changes: Callable[[Sequence[Term]], Numbers]
    rows: Callable[[Any, bool], Array]
    separate: Callable[[], tuple[Array, Array]] | None = None
    outputs: Outputs = ()

    def columns(self, keys: Sequence[Key], *, tested: bool = True) -> Array:
        """Return the rows (N, c) of terms, zero for those that this part does not have."""
        present = [k for k, key in enumerate(keys) if key in self.terms]
        values = np.repeat(0 * self.residuals, len(keys), axis=1)
        if present:
            values[:, present] = self.changes([self.terms[keys[k]] for k in present])
        return self.rows(values, tested)

    def left(self, keys: Sequence[Key]) -> tuple[float, float]:
        """Return the shares of the squares that are left without and with terms."""
        measured, residuals, fitted = (
            self.rows(values, False) for values in (self.measured, self.residuals, self.fitted)
        )
        remaining = beside(residuals, np.hstack([fitted, self.columns(keys, tested=False)]))
        squares = max(float(np.sum(measured**2)), np.finfo(float).tiny)
        return float(np.sum(residuals**2)) / squares, float(np.sum(remaining**2)) / squares


def assessed_misfit(
    nlp: CompiledProblem,
    x: Array,
    trajectories: Sequence[Trajectory],
    candidates: Mapping[str, Formula],
) -> Misfit | None:
    """Return whether a model explains its data at `x` (p,); None where that cannot be told.

    `candidates` has the terms of the user.
    """
    responses, records = [], []
    for part, trajectory in zip(nlp.parts, trajectories, strict=True):
        if isinstance(part, ResponsePart):
            responses.append(_of_response(part, nlp.all_values(x), nlp.free))
        elif isinstance(part, RecordPart) and part.model.has_time and not part.model.is_prior:
            records.append((part, trajectory))

    most = max(MOST // max(len(records), 1), FEWEST)
    records = [_of_record(*record, candidates, most) for record in records]

    (tried, lefts, causes, p_common), timed = (
        _of_group(responses, in_time=False),
        _of_group(records, in_time=True),
    )
    tried, lefts, causes = tried + timed[0], lefts + timed[1], causes + timed[2]
    if not lefts:
        return None
    # What explains most comes first, among what is significant.
    causes.sort(key=lambda cause: (cause.p_value >= FALSE_ALARMS, -cause.share))
    left, noise = max(lefts, key=lambda pair: pair[0] - pair[1])
    return Misfit(left, noise, tried, tuple(causes), p_common)


def _of_group(
    parts: Sequence[_Regression], *, in_time: bool
) -> tuple[int, list[tuple[float, float]], list[Cause], float]:
    """Return the number of terms, the shares that are left, causes, and `Misfit.p_common`.

    A term is missing in all records, or in all responses, of a problem alike.
    """
    # Of two parts, either may be said to need another value.
    either = parts[0].terms if len(parts) == 2 else {}
    terms = {
        key: term
        for part in parts
        for key, term in part.terms.items()
        if term.kind != "own" or key not in either
    }
    if not terms:
        return 0, [], [], 1.0
    tested = [part.rows(part.residuals, True) for part in parts]
    residuals = np.vstack(tested)
    fitted = np.vstack([part.rows(part.fitted, True) for part in parts])
    outputs = _stacked_outputs(parts, [len(rows) for rows in tested])
    filters = whitening_filters(residuals[:, 0], outputs)

    def white(values: Array) -> Array:
        return whitened(values, filters, outputs) if in_time else values

    white_residuals, white_fitted = white(residuals), white(fitted)
    tried, ranked = _ranked(parts, [*terms], white, white_residuals[:, 0], white_fitted)
    ranked = ranked[:FAMILIES]
    together = np.hstack([fitted, *(column for *_, column in ranked[:TOGETHER])])
    without, left = (
        float(np.sum(beside(white_residuals, white(columns)) ** 2))
        for columns in (fitted, together)
    )
    total = len(white_residuals) * (1 - left / without) if without > 0 else 0.0
    p_values = [p_value for (_, p_value, *_), *_ in ranked]
    if in_time and ranked:
        best_columns = np.hstack([column for *_, column in ranked])
        p_values = autoregressive_p_values(residuals[:, 0], fitted, best_columns, outputs).tolist()

    # Real and imaginary parts follow one another in every response.
    lengths = [len(rows) // 2 for rows in tested for _ in "ri"]
    p_common, score, separate, apart = 1.0, None, residuals, fitted
    if not in_time and ranked:
        score = correlated_score(residuals, fitted, lengths)
    if score is not None and len(parts) > 1:
        # Other values may be far from the common ones: each part is fitted by itself.
        separate, apart = _separate(parts)
        p_common = p_value_of_scores(
            score, correlated_score(separate, apart, lengths), fitted, apart
        )
    is_common = p_common >= FALSE_ALARMS

    causes = []
    for ((decrease, _, value, error), key, column), p_value in zip(ranked, p_values, strict=True):
        chances = p_value, p_value
        if terms[key].kind == "own" and not is_common:
            # What other values could explain, too, is no noise.
            noise, taken = float(np.sum(separate**2)), decrease * without / len(residuals)
            remaining = len(residuals) - column_basis(apart).shape[1]
            chances = (float(chance(noise / (noise + taken), remaining)),) * 2
        elif score is not None and p_value < FALSE_ALARMS:
            columns = np.hstack([fitted, column])
            beside_it = correlated_score(residuals, columns, lengths)
            p_beside = p_value_of_scores(score, beside_it, fitted, columns)
            chances = p_value, max(p_value, p_beside)
        share = min(decrease / total, 1.0) if total > 0 else 0.0
        causes.append(
            Cause(
                *terms[key].described(value),
                value,
                error,
                share,
                *np.minimum(tried * np.array(chances), 1.0).tolist(),
            )
        )
    best_keys = [key for _, key, _ in ranked[:TOGETHER]]
    return tried, [part.left(best_keys) for part in parts], causes, p_common


def _ranked(
    parts: Sequence[_Regression],
    keys: list[Key],
    white: Callable[[Array], Array],
    residuals: Array,
    fitted: Array,
) -> tuple[int, list[tuple[list[float], Key, Array]]]:
    """Return the number of terms, and the best of every family with its test and its column.

    `residuals` (N,) and `fitted` (N, p) are white.
    """
    best, tried = {}, 0
    size = COLUMNS // max(len(residuals), 1) + 1
    for chosen in (keys[first : first + size] for first in range(0, len(keys), size)):
        columns = np.vstack([part.columns(chosen) for part in parts])
        tests = score_tests(residuals, fitted, white(columns))
        numbers = tests.T.tolist()
        for k in np.flatnonzero(np.isfinite(tests[1])).tolist():
            tried += 1
            family = chosen[k][0]
            if family not in best or numbers[k] > best[family][0]:
                best[family] = numbers[k], chosen[k], columns[:, [k]]
    return tried, sorted(best.values(), key=lambda test: test[0], reverse=True)


def _stacked_outputs(parts: Sequence[_Regression], lengths: Sequence[int]) -> Outputs:
    """Return the rows of the outputs of all parts, whose rows follow one another."""
    firsts = np.cumsum([0, *lengths[:-1]])
    return [
        [first + rows for rows in stretches]
        for first, part in zip(firsts, parts, strict=True)
        for stretches in part.outputs
    ]


def _separate(parts: Sequence[_Regression]) -> tuple[Array, Array]:
    """Return the residuals (N, 1) of parts with values of their own, and the columns (N, ·)."""
    residuals, columns = zip(*(part.separate() for part in parts if part.separate), strict=True)
    own = np.eye(len(columns))
    blocks = [np.kron(row, block) for row, block in zip(own, columns, strict=True)]
    return np.vstack(residuals), np.vstack(blocks)


def _numbered(terms: Any) -> dict[Key, Term]:
    """Return terms by their family and their number in it, the same in all parts."""
    numbered: dict[Key, Term] = {}
    for term in terms:
        count = sum(family == term.family for family, _ in numbered)
        numbered[term.family, count] = term
    return numbered


def _of_record(
    part: RecordPart,
    trajectory: Trajectory,
    candidates: Mapping[str, Formula],
    most: int,
) -> _Regression:
    residuals = part.residuals(trajectory)
    if part.samples > most:
        part, trajectory, residuals = _on_excerpts(part, trajectory, residuals, most)
    record = DisturbedRecord(part, trajectory)
    weight, data = part.residual_weight(trajectory), part.data
    slopes = sensitivity(part, trajectory, weight)
    noise = np.linalg.inv(weight.T @ weight)
    present = [row > 0 for row in data.unpadded(record.present.astype(float))]

    def rows_of_stretch(values: Array, measured: BoolArray) -> Array:
        result = np.where(measured, weight @ values.swapaxes(0, 1), 0.0)
        return result.reshape(len(result), measured.size).T

    by_initial = data.unpadded(np.einsum("ab,bmn->amn", noise, slopes.by_initial))
    # An offset or a trend cannot be told from a drift of the errors.
    beginnings = [
        np.hstack([rows_of_stretch(by_state, measured), _lines(measured)])
        for by_state, measured in zip(by_initial, present, strict=True)
    ]

    def rows(values: Array, tested: bool) -> Array:
        pairs = zip(data.unpadded(values), present, strict=True)
        stretches = [rows_of_stretch(*pair) for pair in pairs]
        # The initial states and lines of every stretch take their share first.
        return np.vstack([*map(beside, stretches, beginnings)] if tested else stretches)

    firsts = np.cumsum([0, *(row.size for row in present[:-1])])
    outputs = [
        [
            first + k * row.shape[1] + np.flatnonzero(row[k])
            for first, row in zip(firsts, present, strict=True)
        ]
        for k in range(len(present[0]))
    ]
    measured = np.where(record.present, data.measured, np.nan)
    count = np.maximum(record.present.sum(axis=1, keepdims=True), 1)
    return _Regression(
        np.nan_to_num(measured - np.nansum(measured, axis=1, keepdims=True) / count)[:, None],
        residuals[:, None],
        np.einsum("ab,bpn->apn", noise, slopes.weighted),
        _numbered(terms_of_record(record, candidates)),
        lambda terms: record.followed_by([term.effect() for term in terms]),
        rows,
        outputs=outputs,
    )


def _lines(measured: BoolArray) -> Array:
    """Return a constant and a straight line (k n, 2 k) for every output of a stretch (k, n)."""
    outputs, samples = measured.shape
    line = np.vander(np.linspace(-1, 1, samples), 2)
    return np.asarray(np.kron(np.eye(outputs), line) * measured.reshape(-1, 1), dtype=float)


def _on_excerpts(
    part: RecordPart, trajectory: Trajectory, residuals: Array, samples: int
) -> tuple[RecordPart, Trajectory, Array]:
    """Return the part on excerpts of this many samples, with trajectory and residuals there."""
    excerpt = part.excerpt(samples)
    values = np.vstack([part.segments.in_order(trajectory.states), residuals])
    whole = np.zeros((len(values), 1 + max(stretch.rows[-1] for stretch in part.data.stretches)))
    for stretch, row in zip(part.data.stretches, part.data.unpadded(values), strict=True):
        whole[:, stretch.rows] = row

    pieces = [whole[:, stretch.rows] for stretch in excerpt.data.stretches]
    states, residuals = np.split(excerpt.data.padded(pieces, None), [part.states])
    nodes = states[:, :: excerpt.data.segment_length].T
    return excerpt, excerpt.trajectory(trajectory.z, nodes), residuals


def _of_response(part: ResponsePart, values: Array, free: Sequence[str]) -> _Regression:
    response = part.response(values)
    size = part.criterion.error_size(response, part.data)
    used = (size > 0) & (np.abs(response) > 0)
    # One wild point would look like a narrow mode.
    worst = largest_deviation(part, values, len(free))
    if worst is not None and len(used) * worst.probability < SIZE:
        used[worst.index] = False
    order = np.argsort(part.data.omega, kind="stable")
    order = order[used[order]]

    def rows(columns: Any, white: bool) -> Array:
        over = size / np.abs(response) if white else np.ones(len(response))
        scaled = columns[order] / (response * over)[order, None]
        return np.vstack([scaled.real, scaled.imag])

    def residuals(x: Array) -> Array:
        model = part.response(np.append(x, values[len(free) :]))
        return rows((part.data.response - model)[:, None], True)

    def slopes(x: Array) -> Array:
        full = np.append(x, values[len(free) :])
        return rows(part.sensitivity(full)[:, : len(free)], True)

    def separate() -> tuple[Array, Array]:
        from scipy.optimize import least_squares  # noqa: PLC0415  (slow to import)

        jac: Any = lambda x: -slopes(x)  # noqa: E731  (typed as a string)
        x = least_squares(
            lambda x: residuals(x)[:, 0],
            values[: len(free)],
            jac,
            x_scale="jac",
            max_nfev=REFIT,
        ).x
        return residuals(x), slopes(x)

    slope = part.sensitivity(values)[:, : len(free)]
    own = [
        Term("own", lambda k=k: slope[:, k] / response, name, part.name)
        for k, name in enumerate(free)
    ]
    return _Regression(
        response[:, None],
        (part.data.response - response)[:, None],
        slope,
        _numbered([*terms_of_response(part.data.omega), *own]) if order.size else {},
        lambda terms: np.column_stack([response * term.effect() for term in terms]),
        rows,
        separate,
    )


def _percent(share: float) -> str:
    return f"{percent(share)} %"


def _chance(p_value: float) -> str:
    return "p < 1e-9" if p_value < 1e-9 else f"p = {p_value:.2g}"
