"""What a comparison of fits means, in sentences: which model is closer to the data, and which terms these determine."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from greybox.estimate.fitted_part import FittedRecord
from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.files.text_table import counted, listed, number, with_error
from greybox.simulation.prediction import Prediction
from greybox.statistics.metrics import mean_test, whiteness
from greybox.validation.common_likelihood import Likelihoods
from greybox.validation.comparison import EQUAL_AIC, HELD_OUT, IDENTIFICATION, SIGNIFICANT, p_text
from greybox.validation.held_out import Predictions
from greybox.validation.nested_models import NestedTest, nested_test_at
from greybox.validation.nesting import NotNestedError, nested_values
from greybox.validation.same_data import count_unknowns, is_likelihood, other_samples

ESTIMATION = "estimation"  # what the data that fits were made with say of them by their likelihoods

# Windows below which predictions are not tested: the fewest for which `mean_test` estimates a
# correlation, and with two the threshold of Student's t would be 12.7.
FEWEST_WINDOWS = 3

# Predictions whose mean squared errors differ by less than this share of the smaller one (0.05 % in
# rms) are equally good for any use, however significant the difference is in a long record.
EQUAL_SQUARES = 1e-3

# Share within which the 95 % interval of that difference must lie for models to be called equally
# good where no test finds a difference: 5 % in rms, which no use of a model notices. Absence of
# evidence is none of absence.
NEARLY_EQUAL_SQUARES = 0.1

# Of an output's spread: ten times the local error that the simulator allows itself. Differences
# below it are rounding.
SIMULATION_ACCURACY = 1e-6

# Difference of AIC from which the larger one has essentially no support: ibid.
NO_SUPPORT = 10.0

# Standard errors within which an estimate is not distinguishable from zero: 95 % of a normal
# distribution.
NOT_ZERO = 2.0

# p-value below which residuals are called not white: one test for every output of every fit, hence
# less than 5 %.
NOT_WHITE = 0.01

Pair = tuple[int, int]


@dataclass(frozen=True)
class Evidence:
    """What one test says of a pair of models.

    Attributes
    ----------
    better : int or None
        1 where the first describes or predicts the data better, -1 where the second does, 0 where
        both do so equally well; None where it cannot be told.
    sentence : str
    nested : NestedTest or None
        The test, where one of them is the other with terms removed.
    """

    better: int | None
    sentence: str
    nested: NestedTest | None = None

    @property
    def reversed(self) -> "Evidence":
        """The same for the pair in the other order."""
        return replace(self, better=None if self.better is None else -self.better)


def verdicts(
    fits: Sequence[Fit],
    labels: Sequence[str],
    predictions: Mapping[str, Predictions],
    *,
    same_data: bool,
    comparable: bool,
    removed_at: Mapping[str, float] | None = None,
    likelihoods: Likelihoods | None = None,
    aic: Sequence[float] = (),
) -> tuple[tuple[str, ...], Mapping[Pair, Evidence]]:
    """Return the sentences of a comparison, and the tests by the data of the fits.

    `predictions` are those on the data of the fits and on held-out records, as far as there are;
    `comparable` says whether the costs are. What held-out records say stands beside what the data
    of the fits say, not in its place. Fits of responses by different criteria are tested by their
    common `likelihoods`, those that are not nested by their `aic`, where these are known.
    """
    sentences: list[str] = []
    evidence: dict[str, dict[Pair, Evidence]] = {
        kind: {} for kind in (ESTIMATION, IDENTIFICATION, HELD_OUT)
    }
    for a, b in combinations(range(len(fits)), 2):
        pair = (a, b)
        found: dict[str, Evidence] = {}
        if same_data:
            one_criterion = all(
                x.has_criterion_of(y) for x, y in zip(fits[a].parts, fits[b].parts, strict=True)
            )
            tested = likelihoods.fits if likelihoods is not None and not one_criterion else fits
            found[ESTIMATION] = _estimation_evidence(
                tested, labels, pair, comparable, removed_at or {}, aic
            )
        for kind in (IDENTIFICATION, HELD_OUT):
            if kind in predictions:
                better, sentence = _errors_window_by_window(labels, predictions[kind], pair, kind)
                found[kind] = Evidence(better, sentence)
        for kind, said in found.items():
            sentences += [said.sentence] if said.sentence else []
            evidence[kind] |= {(a, b): said, (b, a): said.reversed}

    if comparable and predictions:
        sentences += _residuals_not_white(fits, labels)
    for k in range(len(fits)):
        sentences += _terms(fits, labels, k, evidence)
    if likelihoods is not None:
        sentences.append(_which_likelihood(fits, labels, likelihoods))
    return tuple(sentences), evidence[ESTIMATION]


def _estimation_evidence(
    fits: Sequence[Fit],
    labels: Sequence[str],
    pair: Pair,
    comparable: bool,
    removed_at: Mapping[str, float],
    aic: Sequence[float],
) -> Evidence:
    """Compare two fits by the data that both were made with.

    Nested models by the ratio of their costs or Wald's test: the differences of their
    log-likelihoods have no normal distribution, on which Vuong's test rests. Other models in time
    by that.
    """
    a, b = pair
    two = (fits[a], fits[b])
    undecided = ""
    for small, large in ((a, b), (b, a)) if not other_samples(two, (labels[a], labels[b])) else ():
        try:
            test = _nested_test(fits, labels, (small, large), removed_at)
        except NotNestedError as reason:
            undecided = undecided or (str(reason) if reason.undecided else "")
        except ValueError as error:
            return Evidence(None, f"{_cannot_be_told(labels, pair)}: {error}")
        else:
            better = -1 if small == a else 1
            sentence = f"{labels[large]} contains {labels[small]}, and {test}"
            return Evidence(better if test.p_value < SIGNIFICANT else 0, sentence, test)
    if undecided:
        return Evidence(
            None,
            f"{_cannot_be_told(labels, pair)}: {undecided}{_aic_text(two) if comparable else ''}.",
        )
    if all(len(fit.records) == len(fit.parts) for fit in two):
        return Evidence(*_likelihoods_sample_by_sample(fits, labels, pair))
    return Evidence(*_by_aic(labels, pair, aic)) if aic else Evidence(None, "")


def _by_aic(labels: Sequence[str], pair: Pair, aic: Sequence[float]) -> tuple[int | None, str]:
    """Compare structures that are not nested: those without support beside the other are told."""
    a, b = pair
    both, difference = f"{labels[a]} and {labels[b]}", aic[b] - aic[a]
    said = f"AIC differs by {number(abs(difference), 3)}"
    if abs(difference) < EQUAL_AIC:
        return (
            0,
            f"{both} fit the data equally well ({said}; below {EQUAL_AIC:g} neither is preferred).",
        )
    if abs(difference) < NO_SUPPORT:
        return (
            None,
            f"{_cannot_be_told(labels, pair)} ({said}; from {NO_SUPPORT:g} on one of them has no support).",
        )
    better, worse = (a, b) if difference > 0 else (b, a)
    return (
        1 if difference > 0 else -1
    ), f"{labels[better]} fits the data better than {labels[worse]} ({said})."


def _cannot_be_told(labels: Sequence[str], pair: Pair) -> str:
    return (
        f"It cannot be told which of {labels[pair[0]]} and {labels[pair[1]]} fits the data better"
    )


def _nested_test(
    fits: Sequence[Fit], labels: Sequence[str], order: Pair, removed_at: Mapping[str, float]
) -> NestedTest:
    """Test the first fit of the order against the second.

    Raises
    ------
    NotNestedError, ValueError
        If it is not shown to lie within it, or cannot be tested.
    """
    small, large = (fits[k] for k in order)
    names = (labels[order[0]], labels[order[1]])
    if len(small.free) > len(large.free):
        raise NotNestedError(f"{names[1]} has fewer free parameters than {names[0]}")
    stated = {
        name: value
        for name, value in removed_at.items()
        if name in large.free and name not in small.estimate
    }
    return nested_test_at(nested_values(small, large, names, stated), small, large, names)


def _aic_text(fits: Sequence[Fit]) -> str:
    if not all(is_likelihood(fit) for fit in fits):
        return ""
    values = [2 * (count_unknowns(fit) + fit.cost) for fit in fits]
    return f" (AIC {number(values[0], 6)} and {number(values[1], 6)})"


def _likelihoods_sample_by_sample(
    fits: Sequence[Fit], labels: Sequence[str], pair: Pair
) -> tuple[int | None, str]:
    """Compare the likelihoods of models that are not nested sample by sample, less half of the AIC's penalty.

    Where AIC differs by less than `EQUAL_AIC` nothing is tested: of one model fitted twice the
    differences are rounding. Sources: Vuong (1989), Econometrica 57; for errors that are correlated
    in time Rivers and Vuong (2002), Econometrics Journal 5; Burnham and Anderson (2002), section
    2.6.
    """
    a, b = pair
    differences: list[Array] = []
    for one, other in zip(fits[a].records, fits[b].records, strict=True):
        along = _log_likelihoods(one) - _log_likelihoods(other)
        differences += [along[rows] for rows in one.data.independent_pieces]
    mean, error = mean_test(differences)
    count = sum(int(np.isfinite(d).sum()) for d in differences)
    mean -= (count_unknowns(fits[a]) - count_unknowns(fits[b])) / max(count, 1)

    aic = 2 * abs(mean) * count
    if aic < EQUAL_AIC:
        return 0, (
            f"{labels[a]} and {labels[b]} fit the data equally well (AIC differs by {number(aic, 2)}; below "
            f"{EQUAL_AIC:g} neither is preferred)."
        )
    z = mean / error if error > 0 else 0.0
    p = _two_sided(z)
    if not p < SIGNIFICANT:
        return None, (
            f"{_cannot_be_told(labels, pair)} (Vuong, {p_text(p)}; AIC differs by {number(aic, 2)})."
        )
    better, worse = (a, b) if z > 0 else (b, a)
    sentence = f"{labels[better]} fits the data better than {labels[worse]} (Vuong, {p_text(p)})."
    return (1 if z > 0 else -1), sentence


def _log_likelihoods(part: FittedRecord) -> Array:
    """Return the logarithm of the likelihood of every sample (n,), NaN where nothing was compared."""
    residuals = np.array([part.residual(name) for name in part.outputs])
    present = np.isfinite(residuals)
    variance = np.diag(part.noise)

    if np.count_nonzero(part.noise) == len(
        variance
    ):  # uncorrelated outputs: samples may miss some of them
        squares = np.nan_to_num(residuals) ** 2 / variance[:, None]
        terms = np.where(present, -0.5 * (squares + np.log(2 * np.pi * variance)[:, None]), 0.0)
        return np.where(present.any(axis=0), terms.sum(axis=0), np.nan)

    squares = np.einsum(
        "in,ij,jn->n", np.nan_to_num(residuals), np.linalg.inv(part.noise), np.nan_to_num(residuals)
    )
    logarithm = float(np.linalg.slogdet(2 * np.pi * part.noise)[1])
    return np.where(present.all(axis=0), -0.5 * (squares + logarithm), np.nan)


def _errors_window_by_window(
    labels: Sequence[str], predictions: Predictions, pair: Pair, kind: str
) -> tuple[int | None, str]:
    """Compare the mean squared errors window by window, in units of the smaller noise, see `Evidence.better`.

    A mean difference below `EQUAL_SQUARES` of the smaller mean squared error, or below what
    simulations are accurate to, is a tie whatever the test says: it may have the same sign in every
    window and yet be rounding. Beyond that two models are equally good only where the interval of
    the difference lies within `NEARLY_EQUAL_SQUARES`; where the test finds nothing and the interval
    is wider, nothing can be told. Source: Diebold and Mariano (1995), Journal of Business and
    Economic Statistics 13; for few windows Harvey, Leybourne and Newbold (1997), International
    Journal of Forecasting 13.
    """
    a, b = pair
    squares = [
        _mean_squares(one, other) for one, other in zip(predictions[a], predictions[b], strict=True)
    ]
    differences = [second - first for first, second, _ in squares]
    first, second, rounding = (
        float(np.mean(np.concatenate(values))) for values in zip(*squares, strict=True)
    )
    every = np.concatenate(differences)
    windows = counted(every.size, predictions[a][0].window)
    differences = [
        part
        for d, p in zip(differences, predictions[a], strict=True)
        for part in ([d] if p.data.has_time else [*d[:, None]])
    ]
    both = f"{labels[a]} and {labels[b]}"
    their_data = "their own data" if kind == IDENTIFICATION else "held-out data"

    if every.size < FEWEST_WINDOWS:
        return None, (
            f"{windows} cannot show whether {labels[a]} or {labels[b]} predicts {their_data} better: give "
            f"{'a shorter window, or longer records' if predictions[a][0].data.has_time else 'more rows'}."
        )
    percent = number(100 * abs(second - first) / max(first, second, 1e-300), 2)
    if abs(second - first) <= max(EQUAL_SQUARES * min(first, second), rounding):
        return 0, (
            f"{both} predict {their_data} equally well: their mean squared errors differ by {percent} % "
            f"({windows}), and below {100 * EQUAL_SQUARES:g} % neither is better."
        )

    mean, error = mean_test(differences)
    error *= math.sqrt(every.size / (every.size - 1))
    z = mean / error if error > 0 else 0.0
    p = _two_sided(z, every.size - 1)
    if not p < SIGNIFICANT:
        widest = abs(mean) + _quantile(every.size - 1) * error
        if widest <= NEARLY_EQUAL_SQUARES * min(first, second):
            return 0, (
                f"{both} predict {their_data} equally well: their mean squared errors differ by less than "
                f"{100 * NEARLY_EQUAL_SQUARES:g} % ({windows}, {p_text(p)})."
            )
        return None, (
            f"It cannot be told which of {both} predicts {their_data} better: their mean squared errors differ by "
            f"{percent} % ({windows}, {p_text(p)})."
        )
    better, worse = (a, b) if z > 0 else (b, a)
    share = 100 * float(np.mean(np.sign(every) == np.sign(z)))
    its_data = "its own data" if kind == IDENTIFICATION else "held-out data"
    return (1 if z > 0 else -1), (
        f"{labels[better]} predicts {its_data} better than {labels[worse]}, in {share:.0f} % of {windows} "
        f"({p_text(p)})."
    )


def _mean_squares(one: Prediction, other: Prediction) -> tuple[Array, Array, Array]:
    """Return the mean squared errors of both in every window (w,), and what of them is rounding, in units of noise.

    Values that were estimated from the record make them smaller by their share of its numbers,
    which is undone.
    """
    first, second, rounding = np.zeros((3, len(one)))
    numbers = sum(int(np.isfinite(one.measured(output)).sum()) for output in one.outputs)
    for k, output in enumerate(one.outputs):
        noise = min(one.noise[k, k], other.noise[k, k])
        errors = np.array([one.residual(output), other.residual(output)])
        present = np.all(np.isfinite(errors), axis=0)
        sums = np.where(present, errors**2, 0.0).sum(axis=2) / (
            np.maximum(present.sum(axis=1), 1) * noise
        )
        first += sums[0] * numbers / max(numbers - len(one.own), 1)
        second += sums[1] * numbers / max(numbers - len(other.own), 1)
        rounding += (SIMULATION_ACCURACY * float(np.nanstd(one.data[output]))) ** 2 / noise
    return first, second, rounding


def _residuals_not_white(fits: Sequence[Fit], labels: Sequence[str]) -> Iterator[str]:
    """Warn of criteria that take residuals as white where they are not."""
    colored = []
    for fit, label in zip(fits, labels, strict=True):
        in_time = [part for part in fit.records if part.data.has_time]
        tests = [whiteness([part.residual(output)]) for part in in_time for output in part.outputs]
        if any(test.p_value < NOT_WHITE for test in tests):
            colored.append(label)
    if colored:
        yield (
            f"AIC and BIC assume white residuals, and those of {listed(colored)} are not white: their differences "
            "overstate the evidence."
        )


def _terms(
    fits: Sequence[Fit],
    labels: Sequence[str],
    k: int,
    evidence: Mapping[str, Mapping[Pair, Evidence]],
) -> Iterator[str]:
    """Say of every parameter that another fit does not have free whether these data determine it."""
    quantities = {quantity.name: quantity for quantity in fits[k].quantities}
    for name in fits[k].free:
        without = [i for i, other in enumerate(fits) if i != k and name not in other.free]
        if not without or name.startswith("K_") or name.endswith("_bias"):
            continue
        quantity = quantities[name]
        value, error = with_error(quantity.value, quantity.standard_error)
        stated = f"{name} = {value} ± {error} {quantity.unit}".rstrip() + f" ({labels[k]})"
        # The value of the other models, where they agree on one.
        held = {fits[i].estimate.get(name, 0.0) for i in without}
        other = held.pop() if len(held) == 1 else 0.0
        distance = abs(quantity.value - other)
        from_other = "zero" if other == 0 else number(other)
        if quantity.at_bound:
            yield f"{stated}: ended at its bound, not determined."
        elif not math.isfinite(quantity.standard_error):
            yield f"{stated}: the data do not determine it."
        elif _not_found(name, distance / quantity.standard_error, k, without, evidence):
            yield f"{stated}: not distinguishable from {from_other}."
        elif not any(evidence.values()):
            yield f"{stated}: distinguishable from {from_other}."
        else:
            yield f"{stated}: {_by_evidence(labels, k, without, evidence, from_other)}"


def _not_found(
    name: str,
    t: float,
    k: int,
    without: Sequence[int],
    evidence: Mapping[str, Mapping[Pair, Evidence]],
) -> bool:
    """Tell whether a parameter is not distinguishable from its value elsewhere.

    By the nested test where there is one of this parameter alone, else by its standard error.
    """
    found = [evidence.get(ESTIMATION, {}).get((k, i)) for i in without]
    tests = [
        e.nested
        for e in found
        if e is not None and e.nested is not None and e.nested.terms == (name,)
    ]
    return any(not test.p_value < SIGNIFICANT for test in tests) if tests else t < NOT_ZERO


def _by_evidence(
    labels: Sequence[str],
    k: int,
    without: Sequence[int],
    evidence: Mapping[str, Mapping[Pair, Evidence]],
    value: str,
) -> str:
    """Say what comparisons with the models without a term add to an estimate that is not at its `value` there.

    By the data of the fits, or by held-out records alone where the fits have different data; where
    the two contradict one another both are said.
    """
    kind = next(kind for kind in (ESTIMATION, IDENTIFICATION, HELD_OUT) if evidence.get(kind))
    if (
        kind == ESTIMATION
        and IDENTIFICATION in evidence
        and not any(evidence[ESTIMATION][k, i].sentence for i in without)
    ):
        kind = IDENTIFICATION if evidence[IDENTIFICATION] else kind
    better = {i: evidence[kind][k, i].better for i in without}
    other, equal, unknown = (
        [labels[i] for i in without if better[i] == verdict] for verdict in (-1, 0, None)
    )
    if other:
        text = f"not {value}, but {_explain(other, kind)} better"
    elif unknown:
        text = f"not {value}, but it cannot be told whether {_explain(unknown, kind)} as well"
    elif equal:
        text = f"not {value}, but {_explain(equal, kind)} as well"
    else:
        text = "determined by these data"

    held_out = evidence.get(HELD_OUT, {}) if kind != HELD_OUT else {}
    against = [
        labels[i]
        for i in without
        if (k, i) in held_out and held_out[k, i].better == -1 and better[i] != -1
    ]
    if against:
        text += f", but {_explain(against, HELD_OUT)} better"
    return f"{text}."


def _explain(models: Sequence[str], kind: str) -> str:
    """Say that models without a term explain or predict."""
    verb = "predict{} held-out data" if kind == HELD_OUT else "explain{} the data"
    return f"{listed(models)}, without it, {verb.format('s' if len(models) == 1 else '')}"


def _which_likelihood(fits: Sequence[Fit], labels: Sequence[str], likelihoods: Likelihoods) -> str:
    """Say of which likelihood AIC, AICc and BIC are, and where they are not at its maximum."""
    text = f"AIC, AICc and BIC are those of {likelihoods.said}, maximized from each estimate"
    rules = sorted({part.rule for fit in fits for part in fit.responses if not part.is_likelihood})
    if rules:
        text += f", since {' and '.join(rules)} {'is no likelihood' if len(rules) == 1 else 'are no likelihoods'}"
    elsewhere = [label for label, at in zip(labels, likelihoods.at_maximum, strict=True) if not at]
    if elsewhere:
        text += f"; of {listed(elsewhere)}, which cannot be stated again, at the estimate, where they are too high"
    return f"{text}."


def _quantile(dof: float) -> float:
    from scipy.special import stdtrit  # noqa: PLC0415  (takes a tenth of a second to import)

    return float(stdtrit(dof, 1 - SIGNIFICANT / 2))


def _two_sided(z: float, dof: float = math.inf) -> float:
    from scipy.special import ndtr, stdtr  # noqa: PLC0415  (takes a tenth of a second to import)

    return float(2 * (ndtr(-abs(z)) if math.isinf(dof) else stdtr(max(dof, 1), -abs(z))))
