"""The test of a fit: whether its residuals follow terms that the model does not have."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.disturbances import DisturbedRecord
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import ResponsePart
from greybox.estimate.misfit import EXACT, FALSE_ALARMS, LARGE, Cause, Misfit, Shape
from greybox.estimate.misfit_regression import (
    STEP,
    TINY,
    Key,
    Regression,
    on_excerpts,
    regression_of_record,
    regression_of_response,
)
from greybox.estimate.missing_terms import Term, terms_of_record
from greybox.estimate.repeated_inputs import repeated_residuals
from greybox.files.arrays import Array
from greybox.modeling.added_terms import Formula
from greybox.statistics.autoregressive_test import (
    Outputs,
    autoregressive_p_values,
    whitened,
    whitening_filters,
)
from greybox.statistics.column_space import beside, triangle_of
from greybox.statistics.score_test import correlated_fits, p_values_of_fits, score_tests

# Largest probability at which a model of responses is called wrong, as `FALSE_ALARMS` of records:
# of 1614 simulated right fits, whose errors are white, correlated along frequency, or larger at one
# end, at both ends or in a band, 2.2 % are below it, and of those in white ones 1 %.
OF_RESPONSES = 0.01
# Terms that together explain all of the misfit: more would fit noise.
TOGETHER = 5
KNOTS = 11  # of the shape of a term over a signal

Block = tuple[Array, Array, Sequence[int]]  # see `correlated_fits`
Stack = tuple[Array, Array, Outputs, list[Array]]  # see `_stacked`


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
            responses.append(regression_of_response(part, nlp.all_values(x), nlp.names, moves))
        elif isinstance(part, RecordPart) and part.model.has_time and not part.model.is_prior:
            records.append((part, trajectory))

    # Excerpts of all records together, at least 500 samples of each: a fit would wait for the test
    # of more.
    most = max(3000 // max(len(records), 1), 500)
    disturbed = [
        DisturbedRecord(*on_excerpts(part, trajectory, most)) for part, trajectory in records
    ]
    regressions = [
        regression_of_record(
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
        max(groups, key=lambda group: (not group.is_exact, group.left - group.noise)),
        tried=sum(group.tried for group in groups),
        causes=tuple(causes),
        p_common=min(group.p_common for group in groups),
        shape=groups[-1].shape,
        level=groups[-1].level,
    )


def _stacked(parts: Sequence[Regression]) -> Stack:
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


def _of_group(parts: Sequence[Regression], stack: Stack, determined: Array) -> Misfit:
    """Return the misfit of all records or of all responses, in which a term is missing alike.

    The columns of `determined` (d, k) are what its fit can change.
    """
    # With two parts, either one may need another value; a single part has no counterpart. Beside
    # the values of both, next to nothing would be left of an effect in the part that decides them.
    decisive = max(parts, key=lambda part: np.linalg.norm(part.fitted))
    either = decisive.terms if len(parts) < 3 and np.equal(*determined.shape) else {}
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
    parts: Sequence[Regression], residuals: tuple[Array, Array], outputs: Outputs
) -> Sequence[float]:
    """Return the shares of the squares of the outputs that the model and noise leave."""
    measured = np.vstack([part.measured for part in parts])
    # Perhaps only one of the outputs of a record follows a missing term.
    shares = [
        [float(np.sum(e[rows] ** 2) / (np.sum(measured[rows] ** 2) + TINY)) for e in residuals]
        for rows in [*map(np.concatenate, outputs)] or [...]
    ]
    return max(shares, key=lambda pair: (pair[0] >= EXACT, pair[0] - pair[1]))


def _shape(
    parts: Sequence[Regression],
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
    by_part = [part.signals() for part in parts]
    if len(terms) < len(parts) or not by_part[0]:
        return None
    knots = {
        name: np.linspace(
            (row := np.hstack([signals[name] for signals in by_part])).min(),
            row.max() + TINY,
            KNOTS,
        )
        for name in by_part[0]
    }
    columns = [
        part.changes(
            [
                replace(term, values=np.interp(signals[name], at, hat))
                for name, at in knots.items()
                for hat in np.eye(KNOTS)
            ]
        )
        for part, term, signals in zip(parts, terms, by_part, strict=True)
    ]
    # What the parameters explain is determined neither here nor in the shape of the term, nor are
    # knots with too few samples.
    effects = beside(white(np.hstack([np.vstack(columns), cause.value * column])), fitted)
    by_signal = np.split(effects[:, :-1], len(knots), axis=1)
    for (name, at), of_hats in zip(knots.items(), by_signal, strict=True):
        inverse = np.linalg.pinv(of_hats, rcond=0.02)
        values = inverse @ residuals
        size = float(np.std(residuals - of_hats @ values))
        if size < least:
            errors = size * np.linalg.norm(inverse, axis=1)
            by_term = inverse @ effects[:, -1]
            rows = (np.ravel(row).tolist() for row in (at, values, errors, by_term))
            best, least = Shape(cause.text, name, *map(tuple, rows)), size
    return best


def _alike(effects: Array, texts: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return for every term those whose effects (N, c) are nearly the same."""
    unit = effects / np.linalg.norm(effects, axis=0)
    is_alike = np.abs(unit.T @ unit) - np.eye(len(texts)) > 0.95
    return [tuple(texts[j][0] for j in np.flatnonzero(row).tolist()) for row in is_alike]


def _ranked(
    parts: Sequence[Regression],
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
    size = 300_000 // (len(residuals) + 1) + 1
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


def _p_of_responses(
    parts: Sequence[Regression],
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


def _refitted(parts: Sequence[Regression], determined: Array, key: Any = None) -> Block:
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


def _lengths(parts: Sequence[Regression]) -> list[int]:
    """Return the numbers of real parts and of imaginary parts, which follow one another."""
    return [n // 2 for part in parts if (n := len(part.residuals)) for _ in "ri"]
