"""The test of a fit: whether its residuals follow terms that the model does not have."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import compress, groupby
from typing import Any

import numpy as np

from greybox.assessment.misfit import EXACT, FALSE_ALARMS, LARGE, NOTICED, Cause, Misfit, Shape
from greybox.assessment.misfit_regression import (
    STEP,
    TINY,
    Key,
    Regression,
    is_held,
    regression_of_manoeuvre,
    regression_of_record,
    regression_of_response,
    shortened,
)
from greybox.assessment.missing_terms import KNOTS, Term, constants_of_record, terms_of_record
from greybox.assessment.repeated_inputs import period, repeated_residuals
from greybox.data.files.arrays import Array, sum_of_squares, unit_length
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.disturbances import DisturbedRecord
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.compiled.transient_part import TransientPart
from greybox.engine.covariance.active_limits import active_constraints
from greybox.engine.solve.local_solver import LocalSolver
from greybox.modeling.added_terms import Formula
from greybox.statistics.autoregressive_likelihood import (
    Outputs,
    autoregressive_p_values,
    whitened,
    whitening_filters,
)
from greybox.statistics.column_space import (
    beside,
    column_basis,
    open_directions,
    outside,
    triangle_of,
)
from greybox.statistics.restricted_likelihoods import correlated_fits, p_values_of_fits
from greybox.statistics.score_statistics import joint_test, score_tests

# Terms that together explain all of the misfit: more would fit noise.
TOGETHER = 5
# Largest probability at which a fit with autoregressive errors does not explain records either.
# Slow gusts look like a term more often than noise: of 38 right models in gusts, 8 were between
# this and `FALSE_ALARMS`, and of 148 wrong ones without gusts none.
IN_GUSTS = 0.001
# Numbers of samples whose means are tested first if residuals are white, the first of which a
# simulation follows, and the probability above which there is no other test: that of 3000 samples
# with autoregressive errors takes five times as long. Probabilities allow for the number of terms,
# so that those of right models are mostly one. Of 130 slightly wrong models with white residuals,
# one was called wrong by the other test alone, with p = 0.002.
FEW, CLEAR = (300, 500), 0.3

Block = tuple[Array, Array, Sequence[int]]  # see `correlated_fits`


@frozen
class Group:
    """All records, or all responses, in which a term is missing alike, as one regression.

    The residuals (N, 1) and the columns (N, d) of the parameters have the rows of all parts, of
    which `outputs` has those of every output. The filters make the residuals white, and are missing
    if they are white already.
    """

    parts: Sequence[Regression]
    residuals: Array
    fitted: Array
    outputs: Outputs
    filters: Sequence[Array]

    def columns(self, terms: Iterable[Sequence[Term | None]]) -> Array:
        """Return the columns (N, c) of c terms, as each part has them."""
        return np.vstack([part.columns(each) for part, each in zip(self.parts, terms, strict=True)])

    def white(self, values: Array) -> Array:
        """Return values (N, c) in the rows (M, c) in which residuals are white."""
        return whitened(values, self.filters, self.outputs) if self.filters else values

    @cached_property
    def white_residuals(self) -> Array:
        """The residuals (M, 1), less what earlier samples predict."""
        return self.white(self.residuals)

    @cached_property
    def white_fitted(self) -> Array:
        """The columns (M, d) of the parameters, less what earlier samples predict."""
        return self.white(self.fitted)

    @cached_property
    def basis(self) -> Array:
        """An orthonormal basis (M, r) of what the parameters can take of white residuals."""
        return column_basis(self.white_fitted)

    def score_tests(self, columns: Array) -> Array:
        """Return the tests (c, 4) of columns (N, c) one by one, see `score_tests`."""
        return score_tests(self.white_residuals[:, 0], self.basis, self.white(columns)).T

    def chances(self, tested: Sequence["Tested"]) -> Array:
        """Return the probabilities of terms if errors are white, or autoregressions of records."""
        if not self.filters:
            return np.array([test.p_white for test in tested])
        effects = [test.effects for test in tested]
        # Where records have unlike outputs, errors of outputs count as independent.
        widths = {len(part.outputs) for part in self.parts}
        return autoregressive_p_values(
            self.residuals[:, 0],
            self.fitted,
            np.hstack([self.residuals[:, :0], *effects]),
            self.outputs,
            widths.pop() if len(widths) == 1 else 1,
            sum(part.lost for part in self.parts),
            [each.shape[1] for each in effects],
        )


@frozen
class Tested:
    """A missing term after its test.

    Its factor is that on the column (N, 1), which may combine the `effects` (N, q) of several
    terms that are tested together; see `score_tests`.
    """

    key: Key
    effects: Array
    column: Array
    decrease: float
    p_white: float
    factor: float
    error: float


def assessed_misfit(
    nlp: CompiledProblem,
    x: Array,
    trajectories: Sequence[Trajectory],
    at_bound: Sequence[str],
    candidates: Mapping[str, Formula],
    solver: LocalSolver | None = None,
    is_quick: bool = True,
) -> Misfit | None:
    """Return whether a model explains its data at `x` (p,); None where that cannot be decided.

    Parameters that a bound holds, `at_bound`, absorb nothing. `candidates` has the terms of the
    user. With a `solver`, a model that does not explain records at `x` is tried at other values.
    If residuals are white, a quick test of their means may suffice.
    """
    values, bounded = nlp.all_values(x), np.flatnonzero(np.isin(nlp.free, at_bound))
    # Directions in which the fit can move.
    free = open_directions(active_constraints(nlp, x)[0], bounded)
    responses = [
        regression_of_response(part, values, nlp.names, free) for part in nlp.parts_of(ResponsePart)
    ]
    manoeuvres = [
        regression_of_manoeuvre(part, trajectory, values, nlp.names, free)
        for part, trajectory in nlp.rows_of(TransientPart, trajectories)
    ]
    # Means show what white residuals hide, but repeat less often than inputs of another period.
    is_quick = is_quick and all(
        part.explains_data(trajectory) and period(stretch.inputs) == len(stretch)
        for part, trajectory in nlp.rows_of(RecordPart, trajectories)
        for stretch in part.data.stretches
    )
    disturbed = _disturbed(nlp, trajectories, is_quick)
    # Records are linearized by the solver's variables, responses by the parameters.
    by_x = free.T * nlp.scaling.slope(x)
    held = [*compress(nlp.free, is_held(free))]
    regressions = []
    for record, (repeated, is_new) in zip(disturbed, repeated_residuals(disturbed), strict=True):
        constants = constants_of_record(record)
        terms = [*terms_of_record(record, constants, held, candidates), *repeated]
        regressions.append(
            regression_of_record(record, constants, terms, by_x, is_new, len(disturbed))
        )
    tested = [
        group for group in (responses, manoeuvres, regressions) if any(part.terms for part in group)
    ]
    groups = [_group(parts, is_quick) for parts in tested]
    misfits = [*map(_of_group, groups, _determined(groups))]
    if all(misfit.explains and not misfit.tried for misfit in misfits):
        return None

    # What explains most comes first, among what is significant, and what has no known form last.
    # Of terms with equal texts, the best is reported.
    best = dict[str, Cause]()
    for misfit in misfits:
        for cause in misfit.causes:
            best.setdefault(cause.text, cause)
    # Rounding must not order what explains as much.
    causes = sorted(
        best.values(),
        key=lambda c: (c.p_value >= FALSE_ALARMS, not c.code, -round(c.share, 9)),
    )
    misfit = replace(
        max(misfits, key=lambda misfit: (not misfit.is_exact, misfit.left - misfit.noise)),
        tried=sum(misfit.tried for misfit in misfits),
        causes=tuple(causes),
        p_common=min(misfit.p_common for misfit in misfits),
        shape=misfits[-1].shape,
        level=misfits[-1].level,
    )
    # Gains of a predictor allow for gusts already, and an autoregression also takes up the growing
    # motions that an unstable model lacks.
    is_excluded = misfit.is_unstable or any(record.is_predicted for record in disturbed)
    is_slow = misfit.left > NOTICED and LARGE * (1 - misfit.drift) < 1
    if is_quick and disturbed and not misfit.p_value > CLEAR:
        return assessed_misfit(nlp, x, trajectories, at_bound, candidates, solver, False)
    is_plain = misfit.explains and not is_slow
    if is_plain or solver is None or responses or manoeuvres or is_excluded:
        return misfit
    # Gusts bias the values that a simulation fits, and through a controller they reach the inputs.
    # At biased values, residuals follow the inputs although no term is missing. A missing term
    # biases them, too, perhaps until residuals follow hardly anything but their past.
    x = _with_autoregressive_errors(nlp, x, disturbed)
    other = None
    # Values at a bound or a constraint are no better ones.
    is_at_bound = np.isclose(x, nlp.lower) | np.isclose(x, nlp.upper)
    if not (is_at_bound.any() or active_constraints(nlp, x)[1]):
        other = assessed_misfit(nlp, x, solver.profile(x).trajectories, (), candidates, None, False)
    # An autoregression of few slow motions is uncertain, and its probabilities are too small.
    limit = FALSE_ALARMS / LARGE if is_slow else IN_GUSTS
    if other is None or misfit.explains != (other.p_value < limit):
        return misfit
    if misfit.explains:
        return replace(other, left=misfit.left)
    return replace(misfit, elsewhere=tuple(zip(nlp.free, x.tolist(), strict=True)))


@np.errstate(all="ignore")
def _with_autoregressive_errors(
    nlp: CompiledProblem, x: Array, disturbed: Sequence[DisturbedRecord]
) -> Array:
    """Return the values (p,) that fit records best if their errors are autoregressions.

    With such errors, a simulation is a predictor by the outputs of the past, whose estimates gusts
    and feedback do not bias: Ljung (1999), System Identification, 2nd ed., section 13.4. The search
    begins at `x` (p,).
    """
    from scipy.optimize import least_squares  # noqa: PLC0415  (slow to import)

    @lru_cache(2)
    def group_at(*values: float) -> Group:
        x = np.array(values)
        z, by_x = nlp.scaling.to_solver(x), np.diag(nlp.scaling.slope(x))
        regressions = []
        for here in disturbed:
            # One step of the initial states suffices, which regressions fit, too.
            part, weight = here.part, here.weight
            trajectory = part.trajectory(z, here.trajectory.nodes, simulated=True)
            step = part.condense(part.linearize(trajectory, weight), trajectory).node_step
            trajectory = part.trajectory(z, trajectory.nodes + step, simulated=True)
            record = DisturbedRecord(part, trajectory)
            # The weights of a fit would change with its errors.
            record.weight = weight
            constants = constants_of_record(record)
            regressions.append(
                regression_of_record(record, constants, (), by_x, record.present, len(disturbed))
            )
        group = _group(regressions)
        # Filters that predict the next sample best change to second order with the values.
        return replace(group, filters=[weights / weights[0] for weights in group.filters])

    # Far from the fit, simulations of a nonlinear model may not be finite.
    with suppress(np.linalg.LinAlgError):
        x = least_squares(
            lambda x: group_at(*x).white_residuals[:, 0],
            x,
            lambda x: group_at(*x).white_fitted,  # pyright: ignore[reportArgumentType]
            (nlp.lower, nlp.upper),
            ftol=1e-4,
            x_scale="jac",
            # Most take 3 to 8 evaluations, each of which is two simulations of all records, which
            # are shortened if they are long.
            max_nfev=15,
        ).x
    return x


def _disturbed(
    nlp: CompiledProblem, trajectories: Sequence[Trajectory], is_quick: bool
) -> list[DisturbedRecord]:
    """Return the records, shortened if they are long."""
    rows = nlp.rows_of(RecordPart, trajectories)
    records = [row for row in rows if row[0].model.has_time]

    # Of all records together, at least 500 samples of each: a fit would wait for the test of more.
    # A third of the samples of six outputs tells as much as all of two, but one at a rate of its
    # own has few numbers among them.
    outputs = sum(part.numbers / part.samples for part, *_ in records)
    most = int(max(6000 / max(outputs, 2 * len(records), 1), 500))
    return [shortened(*row, numbers=[*FEW, most] if is_quick else [most]) for row in records]


def _group(parts: Sequence[Regression], is_white: bool = False) -> Group:
    residuals = np.vstack([part.residuals for part in parts])
    fitted = np.vstack([part.fitted for part in parts])
    firsts = np.cumsum([0, *(len(part.residuals) for part in parts)])
    outputs = [
        [first + rows for rows in stretches]
        for first, part in zip(firsts, parts, strict=False)
        for stretches in part.outputs
    ]
    return Group(
        parts,
        residuals,
        fitted,
        outputs,
        [] if is_white else whitening_filters(residuals[:, 0], outputs),
    )


def _determined(groups: Sequence[Group]) -> list[Array]:
    """Return the combinations (d, k) of d parameters that each group may change.

    Combinations that the other group knows much better cannot excuse a misfit.
    """
    if len(groups) < 2:
        return [np.eye(group.fitted.shape[1]) for group in groups]
    rows = [
        group.white_fitted / (np.sqrt(np.mean(group.white_residuals**2)) + TINY) for group in groups
    ]
    # In directions that both determine equally well, whatever the units.
    unit = np.linalg.pinv(triangle_of(np.vstack(rows)))
    pairs = [np.linalg.svd(each @ unit, full_matrices=False)[1:] for each in rows]
    # Where a group has less than a tenth of the information, the other one knows the values.
    return [unit @ axes[share**2 > 0.1].T for share, axes in pairs]


def _of_group(group: Group, determined: Array) -> Misfit:
    """Return the misfit of a group, whose fit can change the columns of `determined` (d, k)."""
    group = replace(group, fitted=np.hstack([group.fitted @ determined, _known(group.parts)]))
    terms = _terms(group.parts, determined)
    tried, tested = _ranked(group, terms)

    def alternatives(test: Tested) -> int:
        """Return how many terms such a one is the best of."""
        family = test.key[0]
        # A bound is doubted more than what nobody thought of.
        if family[0] == "bound":
            return tried[family]
        if group.outputs:
            return tried.total() * terms[test.key].tries
        # Among responses, each family is as likely to be missing, whatever its number of terms.
        return len(tried) * tried[family]

    tests = [*map(alternatives, tested)]
    p_common = 1.0
    p_values = p_correlated = tests * group.chances(tested)
    if group.outputs:
        if min(p_values, default=1.0) > FALSE_ALARMS:
            missing, p_of_functions = _functions(group, terms, tested)
            tested = missing + tested
            p_correlated = p_values = np.append(p_of_functions, p_values)
    elif tested:
        p_of_terms, p_common = _p_of_responses(group, determined, tested, tests)
        p_correlated = np.array(p_of_terms) * tests

    columns = np.hstack([group.residuals[:, :0], *(test.column for test in tested)])
    white = group.white(columns)
    shares, left, noise = _shares(group, tested, columns, white)
    texts = [terms[test.key].described(test.factor, test.error) for test in tested]
    alike = _alike(outside(white, group.basis), texts)
    # Errors that are correlated may hide a term, or look like one.
    p_least = np.minimum(p_values, p_correlated)
    numbers = np.minimum([shares, p_least, p_correlated], 1).T.tolist()
    causes = []
    for test, text, others, row in zip(tested, texts, alike, numbers, strict=True):
        term = terms[test.key]
        added = term.added and (term.b, term.added)
        causes.append(Cause(*text, test.factor, test.error, *row, alike=others, added=added))

    # What earlier samples do not predict. An output of too few samples is not tested.
    count = len(group.residuals)
    innovations = [
        count / float(weights[0]) ** 2
        for weights, rows in zip(group.filters, group.outputs, strict=False)
        if any(map(len, rows))
    ]
    squares = sum_of_squares(group.residuals) + TINY
    return Misfit(
        left,
        noise,
        tried.total(),
        (*causes, *(cause for part in group.parts for cause in part.causes)),
        p_common,
        1 - min(innovations, default=squares) / squares,
        any(part.is_unstable for part in group.parts),
        _shape(group, zip(tested, causes, strict=True)),
        group.parts[0].level,
    )


def _terms(parts: Sequence[Regression], determined: Array) -> dict[Key, Term]:
    """Return the terms of all parts, of which one may need a value of its own."""
    # With two parts, either one may need another value; a single part has no counterpart. Beside
    # the values of both, next to nothing would be left of an effect in the part that decides them.
    decisive = max(parts, key=lambda part: np.linalg.norm(part.fitted))
    either = decisive.terms if len(parts) < 3 and np.equal(*determined.shape) else {}
    return {
        key: term
        for part in parts
        for key, term in part.terms.items()
        if term.kind != "own" or key not in either
    }


def _shares(
    group: Group, tested: Sequence[Tested], columns: Array, white: Array
) -> tuple[Array, float, float]:
    """Return the shares of the misfit that terms explain, and those of the outputs that are left.

    They are what the model leaves of the squares of the outputs, and what noise would leave. The
    terms have columns (N, c), and white ones (M, c).
    """
    residuals = group.residuals
    without, remainder = (
        sum_of_squares(beside(group.white_residuals, fitted))
        for fitted in (group.basis, np.hstack([group.basis, white[:, :TOGETHER]]))
    )
    explained = len(white) * (1 - remainder / (without + TINY)) + TINY
    shares = np.array([test.decrease / explained for test in tested])

    measured = np.vstack([part.measured for part in group.parts])
    noise = beside(residuals, np.hstack([group.fitted, columns[:, :TOGETHER]]))
    # Perhaps only one of the outputs of a record follows a missing term.
    of_outputs = [
        [
            sum_of_squares(e[rows]) / (sum_of_squares(measured[rows]) + TINY)
            for e in (residuals, noise)
        ]
        for rows in [*map(np.concatenate, group.outputs)] or [...]
    ]
    left, least = max(of_outputs, key=lambda pair: (pair[0] >= EXACT, pair[0] - pair[1]))
    if left > LARGE * least:
        # Residuals without noise are whitened by the spectrum of the misfit: slow parts count
        # little.
        basis = column_basis(group.fitted)
        alone = score_tests(residuals[:, 0], basis, columns)[0] / len(residuals)
        shares = np.maximum(shares, alone)
    return shares, left, least


def _shape(group: Group, tests: Iterable[tuple[Tested, Cause]]) -> Shape | None:
    """Return the shape of the best term over the signal that explains most of the residuals."""
    # A wrong value has no shape, and one that a single record needs has no place in the others; the
    # next best term shows what it imitates.
    drawn = [
        (test, cause)
        for test, cause in tests
        if test.key[0][0] != "fixed"
        and cause.p_value < FALSE_ALARMS
        and all(test.key in part.terms for part in group.parts)
    ]
    if not drawn:
        return None
    test, cause = max(drawn, key=lambda pair: pair[1].share)
    by_part = [part.signals() for part in group.parts]
    best, least = None, np.inf
    for name in by_part[0]:
        at, functions = _on_knots(group, test.key, [signals[name] for signals in by_part])
        # What the parameters explain is determined neither here nor in the shape of the term, nor
        # are knots with too few samples.
        both = np.hstack([group.columns(functions), cause.value * test.column])
        effects = outside(group.white(both), group.basis)
        inverse = np.linalg.pinv(effects[:, :-1], rcond=0.02)
        values = inverse @ group.white_residuals
        size = float(np.std(group.white_residuals - effects[:, :-1] @ values))
        if size < least:
            errors = size * np.linalg.norm(inverse, axis=1)
            by_term = inverse @ effects[:, -1]
            rows = (np.ravel(row).tolist() for row in (at, values, errors, by_term))
            best, least = Shape(cause.text, name, *map(tuple, rows)), size
    return best


def _on_knots(
    group: Group, key: Key, signals: Sequence[Array], knots: int = KNOTS
) -> tuple[Array, list[list[Term | None]]]:
    """Return the knots (c,) of signals of all parts, and for each part c functions of its own."""
    whole, shares = np.hstack(signals), np.linspace(0, 1, knots)
    # As many where samples are close together as over the whole range.
    at = (np.quantile(whole, shares) + whole.min() + shares * (np.ptp(whole) + TINY)) / 2
    pairs = zip(group.parts, signals, strict=True)
    return at, [part.on_knots(key, signal, at) for part, signal in pairs]


def _alike(effects: Array, texts: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return for every term the texts of those whose effects (M, c) are nearly the same."""
    unit = unit_length(effects, 0)
    is_alike = np.abs(unit.T @ unit) > 0.95
    names = np.array([name for name, _ in texts], dtype=object)
    # Terms of one name are one cause.
    return [(*names[row & (names != name)],) for row, name in zip(is_alike, names, strict=True)]


def _ranked(group: Group, terms: Mapping[Key, Term]) -> tuple[Counter[Any], list[Tested]]:
    """Return the number of terms that are no functions by family, and the best of each."""
    best = dict[Any, Tested]()
    keys = [key for key, term in terms.items() if not term.knots]
    tried = Counter[Any]()
    # Both factors of a mode are tested together, for motions of any phase.
    pairs = groupby(keys, lambda key: key[1] // 2 if key[0][0] == "flexible" else key)
    together = [[*pair] for _, pair in pairs]
    # With all 1059 terms of a chain of eight states in memory at once, a test takes a quarter more
    # time and 370 MB.
    size = 100_000 // (len(group.residuals) + 1) + 1
    for first in range(0, len(together), size):
        chosen = together[first : first + size]
        columns = group.columns(
            [part.terms.get(key) for pair in chosen for key in pair] for part in group.parts
        )
        tests, end = group.score_tests(columns).tolist(), 0
        for pair in chosen:
            begin, end = end, end + len(pair)
            # The probability is NaN where nothing of a term is left.
            if all(each[1] <= 1 for each in tests[begin:end]):
                family, decrease = pair[0][0], sum(each[0] for each in tests[begin:end])
                tried[family] += len(pair) * terms[pair[0]].count
                # Of two records, either may have a value of its own: the first has, not rounding.
                if family not in best or decrease > best[family].decrease * (1 + 1e-9):
                    effects, numbers = columns[:, begin:end], tests[begin][1:]
                    best[family] = Tested(pair[0], effects, effects, decrease, *numbers)
    tested = [
        _together(group, test.key, test.effects) if test.effects.shape[1] > 1 else test
        for test in best.values()
    ]
    # The best twelve are tested together with the color of the errors.
    return tried, sorted(tested, key=lambda test: -round(test.decrease, 9))[:12]


def _together(group: Group, key: Key, columns: Array) -> Tested:
    """Return the test of columns (N, c) together, and their best combination as one term.

    The factors of the columns in it have unit length, so that its factor is as large as theirs.
    """
    white = group.white(columns)
    p_value, directions = joint_test(group.white_residuals[:, 0], group.basis, white)
    effects = columns @ directions
    factors = directions @ directions.T @ white.T @ outside(group.white_residuals, group.basis)
    column = columns @ factors / (np.linalg.norm(factors) + TINY)
    decrease, _, *factor = group.score_tests(column)[0].tolist()
    return Tested(key, effects, column, decrease, p_value, *factor)


def _place(key: Key) -> str:
    """Return the state, output or input to which a term adds."""
    (_, a, b), _ = key
    return b or a


def _functions(
    group: Group, terms: Mapping[Key, Term], tests: Sequence[Tested]
) -> tuple[list[Tested], Array]:
    """Return functions of any shape that are missing, and their probabilities.

    Functions are tested where one of the other `tests` shows anything.
    """
    tested = []
    # More knots would fit the noise of short records, which lines and initial states leave.
    most = max(len(group.white_residuals) // 15, 2)
    # Functions are tested in place of likely terms: in 1177 simulated tests 11 functions were
    # significant, and where they act a term had a probability, beside white errors, below 0.015.
    places = {_place(test.key) for test in tests if test.p_white < 0.02}
    functions = [key for key, term in terms.items() if term.knots]
    tried = [key for key in functions if _place(key) in places]
    for key in tried:
        # Where a part has no such place, its residuals follow nothing there.
        signals = [
            part.terms[key].values if key in part.terms else np.zeros(0) for part in group.parts
        ]
        columns = group.columns(_on_knots(group, key, signals, min(terms[key].knots, most))[1])
        tested.append(_together(group, key, columns))
    # A test of several numbers counts as that many terms, and so do those that are not made.
    count = sum(test.effects.shape[1] for test in tested) * len(functions) / max(len(tried), 1)
    # Only the best two are tested together with the color of the errors, which takes most of the
    # time, and only if chance does not explain them.
    likeliest = sorted(tested, key=lambda test: test.p_white)[:2]
    best = [test for test in likeliest if max(count, 1) * test.p_white < 1]
    if not best:
        return [], np.array([])
    p_values = count * group.chances(best)
    is_missing = p_values < FALSE_ALARMS
    return [*compress(best, is_missing)], p_values[is_missing]


def _p_of_responses(
    group: Group,
    determined: Array,
    tested: Sequence[Tested],
    tests: Sequence[int],
) -> tuple[list[float], float]:
    """Return the probabilities of terms, and of values common to all parts.

    Terms that may be significant are fitted unless they are to first order.
    """
    parts = group.parts
    terms = [test.column for test in tested]
    fits = correlated_fits([(group.residuals, group.fitted, _lengths(parts))], *terms)
    p_values, p_common = p_values_of_fits(fits, fits)[1:], 1.0
    whole = np.eye(len(determined))
    if len(parts) > 1 or determined.shape != whole.shape:
        # Other values may be far from the common ones: each part is fitted by itself.
        apart = correlated_fits([_refitted([part], whole) for part in parts if part.again])
        [p_common] = p_values_of_fits(fits, apart)
    for k, test in enumerate(tested):
        if parts[0].level < tests[k] * p_values[k] < 1:
            again = _refitted(parts, determined, test.key)
            [p_value] = p_values_of_fits(fits, correlated_fits([again]))
            # A fit of q numbers counts as q terms.
            q = again[1].shape[1] - group.fitted.shape[1]
            p_values[k] = min(p_values[k], p_value / q)
    return p_values, p_common


def _refitted(parts: Sequence[Regression], determined: Array, key: Any = None) -> Block:
    """Return residuals, columns and lengths of responses that are fitted again, with a term.

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
    # take ten. They end at a change of the log likelihood far below what is significant. The method
    # of Levenberg and Marquardt, which needs as many rows as unknowns, may begin with long steps.
    fit = least_squares(
        lambda values: table(*values)[:, 0],
        np.append(np.zeros(k), start),
        lambda values: table(*values)[:, 1:],  # pyright: ignore[reportArgumentType]
        method="lm" if k + start.size <= sum(lengths) else "trf",
        x_scale="jac",
        max_nfev=10,
        ftol=0.3 / sum(lengths),
    )
    return fit.fun[:, None], np.hstack([fit.jac, _known(parts)]), lengths


def _known(parts: Sequence[Regression]) -> Array:
    """Return the columns (N, e) of all parts that no other part has."""
    from scipy.linalg import block_diag  # noqa: PLC0415  (slow to import)

    known = [part.residuals[:, :0] if part.known is None else part.known for part in parts]
    return np.asarray(block_diag(*known), float)


def _lengths(parts: Sequence[Regression]) -> list[int]:
    """Return the numbers of real parts and of imaginary parts, which follow one another."""
    return [
        n // k for part in parts if (n := len(part.residuals)) for k in [part.pieces] * part.pieces
    ]
