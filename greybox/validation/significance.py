"""What a comparison means: which model is closer to the data, which terms these determine."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.files.text_table import counted, listed, number, with_error
from greybox.simulation.prediction import Prediction
from greybox.statistics.metrics import mean_test, whiteness
from greybox.validation.common_likelihood import Likelihoods
from greybox.validation.comparison import EQUAL_AIC, IDENTIFICATION, SIGNIFICANT, p_text
from greybox.validation.held_out import Predictions
from greybox.validation.nested_models import NestedTest, nested_test_at
from greybox.validation.nesting import NotNestedError, nested_values
from greybox.validation.same_data import other_samples

Pair = tuple[int, int]


def verdicts(
    fits: Sequence[Fit],
    labels: Sequence[str],
    predictions: Mapping[str, Predictions],
    *,
    same_data: bool,
    comparable: bool,
    likelihoods: Likelihoods | None = None,
    aic: Sequence[float] = (),
) -> tuple[tuple[str, ...], list[NestedTest]]:
    """Return the sentences of a comparison, and the tests of nested models.

    `predictions` are those on the data of the fits and on held-out records; `comparable` says
    whether the costs are. Fits of responses by different criteria are tested by their common
    `likelihoods`, and by their `aic` if they are not nested.
    """
    sentences: list[str] = []
    tests: list[NestedTest] = []
    for a, b in combinations(range(len(fits)), 2):
        if same_data:
            one_criterion = all(
                x.has_criterion_of(y) for x, y in zip(fits[a].parts, fits[b].parts, strict=True)
            )
            tested = likelihoods.fits if likelihoods is not None and not one_criterion else fits
            sentence, test = fit_verdict(tested, labels, (a, b), aic)
            sentences += [sentence] if sentence else []
            tests += [test] if test else []
        sentences += [
            prediction_verdict(labels, predictions[kind], (a, b), kind) for kind in predictions
        ]

    if comparable and predictions:
        sentences += _residuals_not_white(fits, labels)
    for k in range(len(fits)):
        sentences += term_sentences(fits, labels, k, tests)
    if likelihoods is not None:
        sentences.append(_which_likelihood(labels, likelihoods))
    return tuple(sentences), tests


def fit_verdict(
    fits: Sequence[Fit],
    labels: Sequence[str],
    pair: Pair,
    aic: Sequence[float],
) -> tuple[str, NestedTest | None]:
    """Say which of two fits describes the data better that both were made with.

    Nested models are compared by the ratio of their costs, others of responses by AIC; others of
    records by their predictions alone.
    """
    a, b = pair
    undecided = ""
    orders = [] if other_samples((fits[a], fits[b]), (labels[a], labels[b])) else [pair, (b, a)]
    for small, large in orders:
        try:
            test = _nested_test(fits, labels, (small, large))
        except NotNestedError as reason:
            undecided = undecided or (str(reason) if reason.undecided else "")
        except ValueError as error:
            return f"{_cannot_be_told(labels, pair)}: {error}", None
        else:
            return f"{labels[large]} contains {labels[small]}, and {test}", test
    if undecided:
        return f"{_cannot_be_told(labels, pair)}: {undecided}.", None
    return verdict_by_aic(labels, pair, aic) if aic else "", None


def _nested_test(fits: Sequence[Fit], labels: Sequence[str], order: Pair) -> NestedTest:
    small, large = (fits[k] for k in order)
    names = (labels[order[0]], labels[order[1]])
    if len(small.free) > len(large.free):
        raise NotNestedError(f"{names[1]} has fewer free parameters than {names[0]}")
    return nested_test_at(nested_values(small, large, names), small, large, names)


def verdict_by_aic(labels: Sequence[str], pair: Pair, aic: Sequence[float]) -> str:
    """Compare structures that are not nested by AIC: Burnham and Anderson (2002), section 2.6."""
    a, b = pair
    difference = aic[b] - aic[a]
    by = f"AIC differs by {number(abs(difference), 3)}"
    if abs(difference) < EQUAL_AIC:
        return f"{labels[a]} and {labels[b]} fit the data equally well ({by})."
    if abs(difference) < 10:  # from 10 on, the larger one has essentially no support
        return f"{_cannot_be_told(labels, pair)} ({by}, which is less than 10)."
    better, worse = pair if difference > 0 else (b, a)
    return f"{labels[better]} fits the data better than {labels[worse]} ({by})."


def _cannot_be_told(labels: Sequence[str], pair: Pair) -> str:
    return (
        f"It cannot be told which of {labels[pair[0]]} and {labels[pair[1]]} fits the data better"
    )


def prediction_verdict(
    labels: Sequence[str], predictions: Predictions, pair: Pair, kind: str
) -> str:
    """Compare mean squared errors of predictions window by window, over the smaller noise.

    Mean squared errors that differ by less than 0.1 % (0.05 % in rms), or by less than the accuracy
    of simulations, are equal for any use, however significant the difference is in a long record.
    Where no test finds a difference, the models are equally good only if its 95 % interval is
    within 10 %: absence of evidence is not evidence of absence. Source: Diebold and Mariano (1995),
    Journal of Business and Economic Statistics 13; for few windows Harvey, Leybourne and Newbold
    (1997), International Journal of Forecasting 13.
    """
    a, b = pair
    squares = [mean_squares(*both) for both in zip(predictions[a], predictions[b], strict=True)]
    differences = [second - first for first, second, _ in squares]
    first, second, rounding = (
        float(np.mean(np.concatenate(values))) for values in zip(*squares, strict=True)
    )
    every = np.concatenate(differences)
    windows = counted(every.size, predictions[a][0].window)
    both = f"{labels[a]} and {labels[b]}"
    data = "their own data" if kind == IDENTIFICATION else "held-out data"
    if every.size < 3:  # with two windows the threshold of Student's t would be 12.7
        cure = "a shorter window, or longer records"
        cure = cure if predictions[a][0].data.has_time else "more rows"
        return f"{windows} cannot show which of {both} predicts {data} better: give {cure}."
    equal = f"{both} predict {data} equally well: their mean squared errors differ by"
    percent = f"{number(100 * abs(second - first) / max(first, second, 1e-300), 2)} %"
    if abs(second - first) <= max(1e-3 * min(first, second), rounding):
        return f"{equal} {percent} ({windows})."

    independent = [
        part
        for d, p in zip(differences, predictions[a], strict=True)
        for part in ([d] if p.data.has_time else [*d[:, None]])
    ]
    mean, error = mean_test(independent)
    error *= math.sqrt(every.size / (every.size - 1))
    p = _two_sided(mean / error if error > 0 else 0.0, every.size - 1)
    if not p < SIGNIFICANT:
        widest = abs(mean) + _quantile(every.size - 1) * error
        if widest <= 0.1 * min(first, second):
            return f"{equal} less than 10 % ({windows}, {p_text(p)})."
        return (
            f"It cannot be told which of {both} predicts {data} better: their mean squared errors "
            f"differ by {percent} ({windows}, {p_text(p)})."
        )
    better, worse = pair if mean > 0 else (b, a)
    share = 100 * float(np.mean(np.sign(every) == np.sign(mean)))
    return (
        f"{labels[better]} predicts {data.replace('their', 'its')} better than {labels[worse]}, in "
        f"{share:.0f} % of {windows} ({p_text(p)})."
    )


def mean_squares(first: Prediction, second: Prediction) -> tuple[Array, Array, Array]:
    """Return the mean squared errors of both in every window (w,), and their rounding.

    Values estimated from the record itself make its errors smaller by their share of its numbers,
    which is undone.
    """
    totals = np.zeros((2, len(first)))
    rounding = np.zeros(len(first))
    numbers = sum(int(np.isfinite(first.measured(output)).sum()) for output in first.outputs)
    shares = [numbers / max(numbers - len(p.own), 1) for p in (first, second)]
    for k, output in enumerate(first.outputs):
        noise = min(first.noise[k, k], second.noise[k, k])
        errors = np.array([first.residual(output), second.residual(output)])
        present = np.all(np.isfinite(errors), axis=0)
        count = np.maximum(present.sum(axis=1), 1)
        sums = np.where(present, errors**2, 0.0).sum(axis=2) / (count * noise)
        totals += sums * np.array(shares)[:, None]
        # 1e-6 of the spread: ten times the local error that the simulator allows itself.
        rounding += (1e-6 * float(np.nanstd(first.data[output]))) ** 2 / noise
    return totals[0], totals[1], rounding


def _residuals_not_white(fits: Sequence[Fit], labels: Sequence[str]) -> Iterator[str]:
    """Warn of information criteria that assume white residuals where they are not."""
    colored = []
    for fit, label in zip(fits, labels, strict=True):
        in_time = [part for part in fit.records if part.data.has_time]
        tests = [whiteness([part.residual(name)]) for part in in_time for name in part.outputs]
        # 1 %, since every output of every fit is tested.
        if any(test.p_value < 0.01 for test in tests):
            colored.append(label)
    if colored:
        yield (
            f"AIC and BIC assume white residuals, which those of {listed(colored)} are not: their "
            "differences overstate the evidence."
        )


def term_sentences(
    fits: Sequence[Fit], labels: Sequence[str], k: int, tests: Sequence[NestedTest]
) -> Iterator[str]:
    """Say whether these data determine every parameter that another fit does not have free."""
    quantities = {quantity.name: quantity for quantity in fits[k].quantities}
    for name in fits[k].free:
        without = [rival for i, rival in enumerate(fits) if i != k and name not in rival.free]
        if not without or name.startswith("K_") or name.endswith("_bias"):
            continue
        quantity = quantities[name]
        value, error = with_error(quantity.value, quantity.standard_error)
        estimate = f"{name} = {value} ± {error} {quantity.unit}".rstrip() + f" ({labels[k]})"
        # The value of the other models, where they agree on one.
        held = {rival.estimate.get(name, 0.0) for rival in without}
        reference = held.pop() if len(held) == 1 else 0.0
        text = "zero" if reference == 0 else number(reference)
        # The nested tests of this parameter alone decide, else two standard errors do.
        p_values = [t.p_value for t in tests if t.large == labels[k] and t.terms == (name,)]
        distance = abs(quantity.value - reference)
        is_found = all(p < SIGNIFICANT for p in p_values)
        if quantity.at_bound:
            yield f"{estimate}: ended at its bound, not determined."
        elif not math.isfinite(quantity.standard_error):
            yield f"{estimate}: the data do not determine it."
        elif is_found if p_values else distance >= 2.0 * quantity.standard_error:
            yield f"{estimate}: distinguishable from {text}."
        else:
            yield f"{estimate}: not distinguishable from {text}."


def _which_likelihood(labels: Sequence[str], likelihoods: Likelihoods) -> str:
    """Say which likelihood AIC, AICc and BIC are based on, and where it is not at its maximum."""
    text = f"AIC, AICc and BIC are those of {likelihoods.name}, maximized from each estimate"
    elsewhere = [label for label, at in zip(labels, likelihoods.at_maximum, strict=True) if not at]
    if elsewhere:
        text += f"; those of {listed(elsewhere)} are not at the maximum, and too high"
    return f"{text}."


def _quantile(dof: float) -> float:
    from scipy.special import stdtrit  # noqa: PLC0415  (takes a tenth of a second to import)

    return float(stdtrit(dof, 1 - SIGNIFICANT / 2))


def _two_sided(z: float, dof: float = math.inf) -> float:
    from scipy.special import ndtr, stdtr  # noqa: PLC0415  (takes a tenth of a second to import)

    return float(2 * (ndtr(-abs(z)) if math.isinf(dof) else stdtr(max(dof, 1), -abs(z))))
