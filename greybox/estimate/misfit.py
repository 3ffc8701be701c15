"""Whether a model explains its data, and if not, what it may lack."""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.disturbances import DisturbedRecord
from greybox.compiled.part import ColoredErrors, Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.record_sensitivity import sensitivity
from greybox.compiled.response_part import ResponsePart
from greybox.estimate.diagnostics.outlying_points import SIZE, largest_deviation
from greybox.estimate.missing_terms import Formula, Term, terms_of_record, terms_of_response
from greybox.files.arrays import Array, BoolArray
from greybox.files.text_table import number, text_table, with_error
from greybox.statistics.column_space import column_basis
from greybox.statistics.score_test import p_values_beside_correlation, score_tests

# Share of right models that are said not to explain their data, at most: many fits are made, and
# misfits of the size of the noise have far smaller probabilities.
FALSE_ALARMS = 0.001
NAMED = 3  # causes that are printed with a fit
# Terms that together stand for all of the misfit: more would take up noise.
TOGETHER = 5
Key = tuple[str, int]  # the family of a term, and its number in it
COLUMNS = 2_000_000  # numbers of all terms at once in memory, 16 MB


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
        were tried.
    """

    text: str
    code: str
    value: float
    error: float
    share: float
    p_value: float

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
        Share of the variance that the model leaves, and that noise would leave: of the output that
        it follows least; of a response, the mean squared relative error.
    output : str
        The name of that output; empty for a response.
    tried : int
        Number of terms.
    causes : tuple of Cause
        The best of every family of terms, the one that explains most first.
    """

    left: float
    noise: float
    output: str
    tried: int
    causes: tuple[Cause, ...]

    @property
    def p_value(self) -> float:
        """Probability of such residuals if the model explains the data."""
        return min((cause.p_value for cause in self.causes), default=1.0)

    @property
    def explains(self) -> bool:
        """Whether the residuals look like noise."""
        return not self.p_value < FALSE_ALARMS

    @property
    def is_mostly_noise(self) -> bool:
        """Whether the terms together leave more than half of what the model leaves."""
        return self.noise > self.left / 2

    @property
    def likely(self) -> tuple[Cause, ...]:
        """The causes that are named: up to three, where the model does not explain the data."""
        likely = (cause for cause in self.causes if cause.p_value < FALSE_ALARMS)
        return tuple(itertools.islice(likely, NAMED))

    @property
    def verdict(self) -> str:
        """Whether the model explains the data, in a few words."""
        if self.explains:
            return f"explains the data: the residuals follow none of {self.tried} missing terms"
        left, noise = self.left, self.noise
        what = f"of the variance of {self.output} is left"
        if not self.output:
            left, noise, what = math.sqrt(left), math.sqrt(noise), "rms error is left"
        return (
            f"does not explain the data: {_percent(left)} {what} and follows what drove the test "
            f"({_chance(self.p_value)}); noise alone would leave about {_percent(noise)}"
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
class _Rows:
    """A part as rows of a regression.

    `residuals` (N,) and `fitted` (N, p), what the fit takes from them, are white. `columns` returns
    the white rows (N, c) of some of the `terms`, and `plain` the residuals (k n,), the columns of
    parameters and terms (k n, p + c), and the variances (k,) of the `outputs`.
    """

    outputs: tuple[str, ...]
    residuals: Array
    fitted: Array
    terms: Mapping[Key, Term]
    columns: Callable[[Sequence[Key]], Array]
    plain: Callable[[Sequence[Key]], tuple[Array, Array, Array]]
    in_time: bool


@dataclass(frozen=True, eq=False)
class _Group:
    """The records, or the responses, of a problem: a term is missing in all of them alike."""

    parts: Sequence[_Rows]

    @property
    def terms(self) -> dict[Key, Term]:
        """The terms of all parts."""
        return {key: term for part in reversed(self.parts) for key, term in part.terms.items()}

    @cached_property
    def residuals(self) -> Array:
        """The residuals of all parts (N,)."""
        return np.concatenate([part.residuals for part in self.parts])

    @cached_property
    def fitted(self) -> Array:
        """What the fit takes from them (N, p)."""
        return np.concatenate([part.fitted for part in self.parts])

    def columns(self, keys: Sequence[Key]) -> Array:
        """Return the rows (N, c) of terms; zero in parts that do not have them."""
        blocks = []
        for part in self.parts:
            block = np.zeros((len(part.residuals), len(keys)))
            places = [k for k, key in enumerate(keys) if key in part.terms]
            if places:
                block[:, places] = part.columns([keys[k] for k in places])
            blocks.append(block)
        return np.concatenate(blocks)


@dataclass(frozen=True, eq=False)
class _Tested:
    decrease: float
    cause: Cause
    group: _Group
    key: Key


def assessed_misfit(
    nlp: CompiledProblem,
    x: Array,
    trajectories: Sequence[Trajectory],
    correlation: Sequence[ColoredErrors | None],
    candidates: Mapping[str, Formula],
) -> Misfit | None:
    """Return whether a model explains its data at `x` (p,); None where that cannot be told.

    `correlation` has the spectra of the errors of records.
    """
    responses, records = [], []
    for part, trajectory, colored in zip(nlp.parts, trajectories, correlation, strict=True):
        if isinstance(part, ResponsePart):
            rows = _of_response(part, nlp.all_values(x), len(x))
            responses += [rows] if rows.residuals.size else []
        elif isinstance(part, RecordPart) and part.model.has_time and not part.model.is_prior:
            records.append(_of_record(part, trajectory, colored, candidates))

    groups = [_Group(parts) for parts in (responses, records) if parts]
    tests = [test for group in groups for test in _tests(group)]
    if not tests:
        return None
    families: dict[str, _Tested] = {}
    for test in sorted(tests, key=lambda test: -test.decrease):
        families.setdefault(test.key[0], test)

    best = [_beside_correlation(test) for test in families.values()]
    causes: list[Cause] = []
    lefts = []
    for group in groups:
        of_group = [test for test in best if test.group is group]
        chosen = [test.key for test in of_group[:TOGETHER]]
        if not chosen:
            continue
        total = _explained(group, chosen)
        lefts += [pair for part in group.parts for pair in _left(part, chosen)]
        causes += [
            replace(
                test.cause,
                share=min(test.decrease / total, 1.0) if total > 0 else 0.0,
                p_value=min(test.cause.p_value * len(tests), 1.0),
            )
            for test in of_group
        ]
    # What explains most comes first, within what is significant.
    causes.sort(key=lambda cause: (cause.p_value >= FALSE_ALARMS, -cause.share))
    left, noise, output = max(lefts, key=lambda values: values[0] - values[1])
    return Misfit(left, noise, output, len(tests), tuple(causes))


def _tests(group: _Group) -> list[_Tested]:
    """Return the tests of all terms that can be told from the parameters."""
    tests = []
    terms = group.terms
    keys = [*terms]
    size = max(COLUMNS // len(group.residuals), 1)
    for first in range(0, len(keys), size):
        chosen = keys[first : first + size]
        result = score_tests(
            group.residuals,
            group.fitted,
            group.columns(chosen),
            in_time=group.parts[0].in_time,
        )
        for k, key in enumerate(chosen):
            value, error, p_value, decrease = (
                float(numbers[k])
                for numbers in (result.value, result.error, result.p_value, result.decrease)
            )
            if not math.isnan(p_value):
                text = terms[key].described(value)
                cause = Cause(text, terms[key].code, value, error, math.nan, p_value)
                tests.append(_Tested(decrease, cause, group, key))
    return tests


def _beside_correlation(test: _Tested) -> _Tested:
    """Return the test of a response with a probability that allows for correlated neighbors."""
    group = test.group
    if group.parts[0].in_time or test.cause.p_value > FALSE_ALARMS:
        return test
    lengths = [len(part.residuals) // 2 for part in group.parts for _ in range(2)]
    p_value = p_values_beside_correlation(
        group.residuals, group.fitted, group.columns([test.key]), lengths
    )[0]
    return replace(test, cause=replace(test.cause, p_value=max(float(p_value), test.cause.p_value)))


def _explained(group: _Group, keys: Sequence[Key]) -> float:
    """Return what terms take together from the sum of squares, over their mean."""
    without = _remaining(group.residuals, group.fitted)
    together = _remaining(group.residuals, np.hstack([group.fitted, group.columns(keys)]))
    squares = float(without @ without)
    return len(without) * (1 - float(together @ together) / squares) if squares > 0 else 0.0


def _left(rows: _Rows, keys: Sequence[Key]) -> list[tuple[float, float, str]]:
    """Return the share of the variance of outputs that is left without and with terms."""
    residuals, columns, variance = rows.plain([key for key in keys if key in rows.terms])
    count = len(variance)
    remaining = _remaining(residuals, columns)
    left, noise = (
        (values.reshape(count, -1) ** 2).mean(axis=1) / variance
        for values in (residuals, remaining)
    )
    return list(zip(left.tolist(), noise.tolist(), rows.outputs, strict=True))


def _remaining(values: Array, columns: Array) -> Array:
    basis = column_basis(columns)
    return values - basis @ (basis.T @ values)


def _numbered(terms: Iterable[tuple[Term, Any]]) -> dict[Key, tuple[Term, Any]]:
    """Return terms by their family and number in it, which are the same for all parts."""
    counts: dict[str, int] = {}
    numbered = {}
    for term, value in terms:
        counts[term.family] = counts.get(term.family, 0) + 1
        numbered[term.family, counts[term.family]] = (term, value)
    return numbered


def _of_record(
    part: RecordPart,
    trajectory: Trajectory,
    colored: ColoredErrors | None,
    candidates: Mapping[str, Formula],
) -> _Rows:
    weight = part.residual_weight(trajectory)
    slopes = sensitivity(part, trajectory, weight)
    noise = np.linalg.inv(weight.T @ weight)
    k, data = len(part.outputs), part.data
    present = data.unpadded(part.segments.in_order(trajectory.detail.data[-1 - k : -1]) > 0)
    spectrum = None if colored is None else colored.spectrum

    def white(values: Array, measured: Array) -> Array:
        """Return values (c, k, n) as rows (k n, c)."""
        if spectrum is None:
            result = np.where(measured, weight @ values, 0.0)
        else:
            result = np.nan_to_num(spectrum.whitened(np.where(measured, values, np.nan)))
        return result.reshape(len(result), result[:1].size or measured.size).T

    initial = [
        column_basis(white(np.einsum("ab,bmn->man", noise, X), measured))
        for X, measured in zip(data.unpadded(slopes.by_initial), present, strict=True)
    ]

    def rows(values: Sequence[Array]) -> Array:
        """Return values (k, c, n) of every stretch as rows, less what initial states take."""
        result = []
        for value, measured, basis in zip(values, present, initial, strict=True):
            row = white(value.swapaxes(0, 1), measured)
            result.append(row - basis @ (basis.T @ row))
        return np.concatenate(result)

    record = DisturbedRecord(part, trajectory)
    terms = _numbered(terms_of_record(part, record, candidates))
    residuals = data.unpadded(part.residuals(trajectory))
    fitted = [np.einsum("ab,bpn->apn", noise, J) for J in data.unpadded(slopes.weighted)]

    def changes(keys: Sequence[Key]) -> list[Array]:
        return record.followed_by([terms[key][1] for key in keys])

    def plain(keys: Sequence[Key]) -> tuple[Array, Array, Array]:
        columns = np.concatenate(
            [
                np.concatenate(both, axis=1)
                for both in zip(fitted, changes(keys) if keys else fitted, strict=True)
            ],
            axis=2,
        )
        measured = np.concatenate([stretch.outputs for stretch in data.stretches], axis=1)
        present_values = [row[np.isfinite(row)] for row in measured]
        variance = np.array([row.var() if row.size else 1.0 for row in present_values])
        return (
            np.concatenate(residuals, axis=1).ravel(),
            columns.transpose(0, 2, 1).reshape(-1, columns.shape[1]),
            np.maximum(variance, np.finfo(float).tiny),
        )

    return _Rows(
        part.outputs,
        rows([e[:, None] for e in residuals])[:, 0],
        rows(fitted),
        {key: term for key, (term, _) in terms.items()},
        lambda keys: rows(changes(keys)),
        plain,
        in_time=True,
    )


def _of_response(part: ResponsePart, values: Array, free: int) -> _Rows:
    response = part.response(values)
    size = part.criterion.error_size(response, part.data)
    terms = _numbered(terms_of_response(part))
    points = _without_outlier(part, values, free) & (size > 0) & (np.abs(response) > 0)
    order = np.argsort(part.data.omega, kind="stable")
    order = order[points[order]]
    turned = np.exp(1j * np.angle(response))

    def rows(columns: Array, over: Array = size) -> Array:
        scaled = columns[order] / (turned * over)[order, None]
        return np.vstack([scaled.real, scaled.imag])

    error = (part.data.response - response)[:, None]
    slope = part.sensitivity(values)[:, :free]

    def changes(keys: Sequence[Key]) -> Array:
        return np.column_stack([response * terms[key][1] for key in keys])

    def plain(keys: Sequence[Key]) -> tuple[Array, Array, Array]:
        columns = np.column_stack([slope, changes(keys)])
        magnitude = np.abs(response)
        # Real and imaginary parts have half of the squared error each.
        return rows(error, magnitude)[:, 0], rows(columns, magnitude), np.array([0.5])

    return _Rows(
        ("",),
        rows(error)[:, 0],
        rows(slope),
        {key: term for key, (term, _) in terms.items()},
        lambda keys: rows(changes(keys)),
        plain,
        in_time=False,
    )


def _without_outlier(part: ResponsePart, values: Array, free: int) -> BoolArray:
    """Return which points (n,) are no outlier: one wild point would look like a narrow mode."""
    points = np.ones(len(part.data), dtype=bool)
    worst = largest_deviation(part, values, free)
    if worst is not None and len(points) * worst.probability < SIZE:
        points[worst.index] = False
    return points


def _percent(share: float) -> str:
    return f"{float(number(100 * share, 2)):g} %"


def _chance(p_value: float) -> str:
    return "p < 1e-9" if p_value < 1e-9 else f"p = {p_value:.2g}"
