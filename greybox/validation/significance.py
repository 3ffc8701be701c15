"""What a comparison of fits means, in sentences: which model is closer to the data, and which terms these determine."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from greybox.data.text_table import counted, number, with_error
from greybox.estimate.result import Fit, FittedRecord
from greybox.simulation.prediction import Prediction
from greybox.statistics.metrics import mean_test, whiteness
from greybox.validation.comparison import HELD_OUT, IDENTIFICATION

Array = NDArray[np.float64]
Predictions = tuple[tuple[Prediction, ...], ...]
LEVEL = 0.05
FEW = 3  # windows below which there is no test
ALIKE = 1e-3  # of the mean squared error: predictions that differ by less are alike
ACCURATE = 1e-6  # of an output's spread, to which simulations are accurate
EQUAL = 2.0  # difference of AIC below which two models are supported alike
ZERO = 2.0  # standard errors within which an estimate is not distinguishable from zero


def verdicts(
    fits: Sequence[Fit], names: Sequence[str], found: Mapping[str, Predictions], *, same: bool, comparable: bool
) -> tuple[str, ...]:
    """Return the sentences of a comparison."""
    pairs = list(combinations(range(len(fits)), 2))
    said = []
    closer: dict[tuple[int, int], float] = {}
    for a, b in pairs:
        if same and all(fit.records and len(fit.records) == len(fit.parts) for fit in (fits[a], fits[b])):
            said.append(_vuong(fits, names, a, b))
        for place in (IDENTIFICATION, HELD_OUT):
            if place in found:
                z, words = _windows(names, found[place], a, b, place)
                said.append(words)
                closer[a, b], closer[b, a] = z, -z
    if comparable and found:
        said += _colored(fits, names)
    for k, fit in enumerate(fits):
        said += _terms(fits, names, k, fit, closer)
    said += _criteria(fits) if comparable else ()
    return tuple(said)


def _vuong(fits: Sequence[Fit], names: Sequence[str], a: int, b: int) -> str:
    """Compare the likelihoods sample by sample, less half of the AIC's penalty.

    Where AIC differs by less than `EQUAL` nothing is tested: of one model fitted twice the differences are rounding.
    Sources: Vuong (1989), Econometrica 57; for errors that are correlated in time Rivers and Vuong (2002), Econometrics
    Journal 5; Burnham and Anderson (2002), section 2.6.
    """
    differences: list[Array] = []
    for one, other in zip(fits[a].records, fits[b].records, strict=True):
        along = _likelihoods(one) - _likelihoods(other)
        differences += np.split(along, np.cumsum([len(piece) for piece in one.data.pieces])[:-1])
    mean, error = mean_test(differences)
    count = sum(int(np.isfinite(d).sum()) for d in differences)
    mean -= (_unknowns(fits[a]) - _unknowns(fits[b])) / max(count, 1)
    if 2 * abs(mean) * count < EQUAL:
        return (
            f"{names[a]} and {names[b]} describe the data of the fit as well as one another (AIC differs by "
            f"{number(2 * abs(mean) * count, 2)}; below {EQUAL:g} neither is preferred)."
        )
    z = mean / error if error > 0 else 0.0
    p = _two_sided(z)
    if not p < LEVEL:
        return f"{names[a]} and {names[b]} describe the data of the fit as well as one another (Vuong, {_p(p)})."
    better, worse = (a, b) if z > 0 else (b, a)
    return f"{names[better]} describes the data of the fit better than {names[worse]} (Vuong, {_p(p)})."


def _likelihoods(part: FittedRecord) -> Array:
    """Return the logarithm of the likelihood of every sample (n,), NaN where nothing was compared."""
    e = np.array([part.residual(name) for name in part.outputs])
    there, variance = np.isfinite(e), np.diag(part.noise)
    if np.count_nonzero(part.noise) == len(variance):  # samples may miss some outputs
        terms = np.where(there, -0.5 * (np.nan_to_num(e) ** 2 / variance[:, None]), 0.0)
        terms = terms - np.where(there, 0.5 * np.log(2 * np.pi * variance)[:, None], 0.0)
        return np.where(there.any(axis=0), terms.sum(axis=0), np.nan)
    squares = np.einsum("in,ij,jn->n", np.nan_to_num(e), np.linalg.inv(part.noise), np.nan_to_num(e))
    logarithm = float(np.linalg.slogdet(2 * np.pi * part.noise)[1])
    return np.where(there.all(axis=0), -0.5 * (squares + logarithm), np.nan)


def _unknowns(fit: Fit) -> int:
    return len(fit.free) + sum(part.nuisances for part in fit.records)


def _windows(names: Sequence[str], found: Predictions, a: int, b: int, place: str) -> tuple[float, str]:
    """Compare the mean squared errors window by window, in units of the smaller noise; positive where a is better.

    A mean difference below `ALIKE` of the smaller mean squared error, or below what simulations are accurate to, is a
    tie whatever the test says: it may have the same sign in every window and yet be rounding.
    Source: Diebold and Mariano (1995), Journal of Business and Economic Statistics 13.
    """
    squares = [_squares(one, other) for one, other in zip(found[a], found[b], strict=True)]
    differences = [theirs - ours for ours, theirs, _ in squares]
    every = np.concatenate(differences)
    ours, theirs, rounding = (float(np.mean(np.concatenate(values))) for values in zip(*squares, strict=True))
    data = "its own data" if place == IDENTIFICATION else "held-out data"
    if every.size < FEW:
        return 0.0, (
            f"whether {names[a]} or {names[b]} predicts {data.replace('its', 'their')} better cannot be told from "
            f"{counted(every.size, 'window')}: give a shorter window, or longer records."
        )
    if abs(theirs - ours) <= max(ALIKE * min(ours, theirs), rounding):
        share = 100 * abs(theirs - ours) / max(ours, theirs, 1e-300)
        return 0.0, (
            f"{names[a]} and {names[b]} predict {data.replace('its', 'their')} alike: their mean squared errors differ "
            f"by {number(share, 2)} % ({counted(every.size, 'window')}), and below {100 * ALIKE:g} % neither is better."
        )
    mean, error = mean_test(differences)
    z = mean / error if error > 0 else 0.0
    p = _two_sided(z, every.size - 1)
    if not p < LEVEL:
        data = data.replace("its", "their")
        return 0.0, (
            f"{names[a]} and {names[b]} predict {data} as well as one another ({counted(every.size, 'window')}, "
            f"{_p(p)})."
        )
    better, worse = (a, b) if z > 0 else (b, a)
    share = 100 * float(np.mean(np.sign(every) == np.sign(z)))
    return z, f"{names[better]} predicts {data} better than {names[worse]}, in {share:.0f} % of the windows ({_p(p)})."


def _squares(one: Prediction, other: Prediction) -> tuple[Array, Array, Array]:
    """Return the mean squared errors of both in every window (w,), and what of them is rounding, in units of noise."""
    ours, theirs, rounding = np.zeros(len(one)), np.zeros(len(one)), np.zeros(len(one))
    for k, output in enumerate(one.outputs):
        noise = min(one.noise[k, k], other.noise[k, k])
        errors = (one.residual(output), other.residual(output))
        there = np.isfinite(errors[0]) & np.isfinite(errors[1])
        count = np.maximum(there.sum(axis=1), 1) * noise
        first, second = (np.where(there, e**2, 0.0).sum(axis=1) / count for e in errors)
        ours, theirs = ours + first, theirs + second
        rounding += (ACCURATE * float(np.nanstd(one.data[output]))) ** 2 / noise
    return ours, theirs, rounding


def _colored(fits: Sequence[Fit], names: Sequence[str]) -> Iterator[str]:
    """Warn of criteria that take residuals as white where they are not."""
    colored = []
    for fit, name in zip(fits, names, strict=True):
        tests = [whiteness([part.residual(output)]) for part in fit.records for output in part.outputs]
        if any(test.p_value < 0.01 for test in tests):
            colored.append(name)
    if colored:
        yield (
            f"AIC and BIC take residuals as white, and those of {_listed(colored)} are not: their differences are "
            "larger than the data bear out."
        )


def _terms(
    fits: Sequence[Fit], names: Sequence[str], k: int, fit: Fit, closer: Mapping[tuple[int, int], float]
) -> Iterator[str]:
    """Say of every parameter that another fit does not have whether these data determine it."""
    quantities = {q.name: q for q in fit.quantities}
    for name in fit.free:
        others = [i for i, other in enumerate(fits) if i != k and name not in other.free]
        if not others or name.startswith("K_") or name.endswith("_bias"):
            continue
        q = quantities[name]
        value, error = with_error(q.value, q.standard_error)
        said = f"{name} = {value} ± {error} {q.unit}".rstrip() + f" ({names[k]})"
        if q.at_bound:
            yield f"{said}: ended at its bound, not determined."
        elif not math.isfinite(q.standard_error):
            yield f"{said}: the data do not determine it."
        elif abs(q.value) < ZERO * q.standard_error:
            yield f"{said}: not distinguishable from zero."
        elif not closer:
            yield f"{said}: distinguishable from zero."
        else:
            yield f"{said}: {_determined([(names[i], closer[k, i]) for i in others])}"


def _determined(others: Sequence[tuple[str, float]]) -> str:
    """Say what predictions add to an estimate that is distinguishable from zero."""
    better = [name for name, z in others if z < 0]
    if better:
        return f"not zero, but {_listed(better)}, without it, explains the data better."
    equal = [name for name, z in others if z == 0]
    if equal:
        return f"not zero, but {_listed(equal)}, without it, explains the data as well."
    return "determined by these data."


def _criteria(fits: Sequence[Fit]) -> Iterator[str]:
    """Say which measures do not exist for fits of responses."""
    rules = {part.rule for fit in fits for part in fit.responses if not part.is_likelihood}
    if rules:
        yield (
            f"AIC and BIC do not exist for {' and '.join(sorted(rules))}, which is no likelihood: compare the costs; "
            "with the variance of every point, MaximumLikelihood() has them."
        )


def _listed(names: Sequence[str]) -> str:
    """Return "a", "a and b" or "a, b and c"."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _two_sided(z: float, dof: float = math.inf) -> float:
    from scipy.special import ndtr, stdtr  # noqa: PLC0415  (takes a tenth of a second to import)

    return float(2 * (ndtr(-abs(z)) if math.isinf(dof) else stdtr(max(dof, 1), -abs(z))))


def _p(p: float) -> str:
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"
