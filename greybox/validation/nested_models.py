"""Whether the terms that one model has more than another are needed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.files.text_table import listed, number, one_line
from greybox.validation.comparison import SIGNIFICANT, p_text
from greybox.validation.nesting import Nesting, NotNestedError, nesting
from greybox.validation.same_data import (
    check_fits,
    count_numbers,
    data_difference,
    is_likelihood,
    labels_of,
    other_samples,
)

# How far twice the log-likelihood of the larger model may lie below that of the smaller: 0.02,
# where 3.84 is significant at 5 %, since the two may have steps of different length, of which those
# are short enough that shift the estimate by up to a tenth of a standard error; or what solvers
# leave of a large cost, 1e-9 of it.
RATIO_TOLERANCE = 0.02
RELATIVE_COST_TOLERANCE = 1e-9

# Relative eigenvalue below which the data do not see a direction of parameter space: that of
# rounding, twice.
RANK = 1e-14

# What scales a ratio, in words.
IN_TIME = "residuals that are correlated in time"
BEYOND = "residuals beyond the given variance"
SIZE = "the size of the errors"


@dataclass(frozen=True)
class NestedTest:
    """Whether terms that one model has more than another are needed. Printing it says so in words.

    Attributes
    ----------
    small, large : str
        The models.
    terms : tuple of str
        The parameters that are free in the larger alone.
    likelihood_ratio : float
        Twice the difference of the costs; NaN where no ratio can be formed.
    scale : float
        What makes it one of likelihoods: by how much the correlation of the residuals in time
        inflates it, 1 for white residuals; of rows without a time whose variance was given, by how
        much the residuals' own is larger; of responses, what the size of the errors says of the
        criterion.
    statistic : float
        What is compared with the F distribution.
    dof : (float, float)
        Its degrees of freedom; the second is `Fit.dof` of the larger.
    p_value : float
    scaled_for : str
        What the scale accounts for, in words.
    """

    small: str
    large: str
    terms: tuple[str, ...]
    likelihood_ratio: float
    scale: float
    statistic: float
    dof: tuple[float, float]
    p_value: float
    scaled_for: str = IN_TIME

    def __repr__(self) -> str:
        return one_line(self, f"{self.small} in {self.large}", p_text(self.p_value))

    def __str__(self) -> str:
        names = ", ".join(self.terms)
        verb = "is" if len(self.terms) == 1 else "are"
        if self.p_value < SIGNIFICANT:
            verdict = (
                f"{names} {verb} needed: {self.small} is rejected by the test against {self.large}"
            )
        else:
            verdict = (
                f"{names} {verb} not needed: {self.small} explains the data as well as {self.large}"
            )

        numerator, denominator = self.dof
        if math.isinf(denominator):
            statistic = f"chi2({numerator:g}) = {number(self.statistic * numerator, 4)}"
        else:
            statistic = f"F({numerator:g}, {denominator:.0f}) = {number(self.statistic, 4)}"

        method = "Wald test with the standard errors of the fit"
        if not math.isnan(self.likelihood_ratio):
            scaled = self.scaled_for == IN_TIME or self.scale != 1.0
            ratio = (
                "twice the difference of the costs"
                if self.scaled_for == SIZE
                else "likelihood ratio"
            )
            method = f"{ratio} {number(self.likelihood_ratio, 4)}"
            method += (
                f", divided by {number(self.scale, 3)} for {self.scaled_for}" if scaled else ""
            )
        return f"{verdict} ({statistic}, {p_text(self.p_value)}; {method})."


def nested_test(
    small: Fit, large: Fit, *, removed_at: Mapping[str, float] | None = None
) -> NestedTest:
    """Test whether the parameters that `large` has free and `small` has not are needed.

    That `large` contains `small` is decided by the parameters that `small` fixes or ties within the
    bounds of `large` and, where the two are different models, by their equations: they must agree
    at random points where the parameters that `small` lacks are zero or one.

    The likelihood ratio is divided by the factor by which correlation of the residuals in time
    inflates the variance of these parameters, so that the test keeps its size there (the mean of
    the scaled statistic is that of chi-square, over its degrees of freedom F). Of rows without a
    time it is the F test of least squares. Of frequency responses it is the ratio of whatever
    criterion was minimized, by the same rule: divided by the variance that the standard errors give
    these parameters over the one that the curvature of the cost says. Where there is no such ratio,
    the estimates are compared with their values in `small` by their covariance (Wald). Where one of
    these values is on a bound, the statistic has half of its distribution at one degree of freedom
    less; where several are, half of it at most has them all, and the p-value is an upper limit. So
    is decided whether there is process noise: `OutputError` is `PredictionError(process_noise=...)`
    with none.

    Parameters
    ----------
    small, large : Fit
        Of the same data.
    removed_at : mapping of name to value, optional
        At which parameters leave the larger model as the smaller one, where neither zero nor one
        does, or where their equations cannot be compared: ``{"T_rotor": 0.0}``. It is taken on
        trust.

    Raises
    ------
    ValueError
        If the data differ, `small` is not shown to be `large` with terms removed, or `large` costs
        more.

    Sources: Rotnitzky and Jewell (1990), Biometrika 77; Satorra and Bentler (1994); Klein and
    Morelli, chapter 5; Self and Liang (1987), Journal of the American Statistical Association 82.
    """
    check_fits((small, large))
    labels = _labels(small, large)
    different = data_difference((small, large), labels) or other_samples((small, large), labels)
    if different:
        raise ValueError(f"{different}: a nested test needs fits of the same data.")

    try:
        place = nesting(small, large, labels, removed_at)
    except NotNestedError as reason:
        raise ValueError(
            f"{labels[0]} (free: {', '.join(small.free)}) is not {labels[1]} (free: {', '.join(large.free)}) with "
            f"terms removed, as far as can be shown: {reason}. Fix or remove parameters of the larger model, state the "
            "values that remove them, removed_at={name: value}, or use gb.compare, which needs no nesting."
        ) from None
    return nested_test_at(place, small, large, labels)


def nested_test_at(place: Nesting, small: Fit, large: Fit, labels: tuple[str, str]) -> NestedTest:
    """Test a fit against a larger one in which it lies at this `place`.

    Raises
    ------
    ValueError
        If the data do not determine the terms, or `large` costs more.
    """
    r = place.dof
    covariance = large.covariance_of(large.free)
    at_bound = {q.name for q in large.quantities if q.at_bound and q.kind == "free"}
    stuck = [name for name in place.terms if name in at_bound]
    if stuck and not set(stuck) <= set(place.on_bound):
        raise ValueError(
            f"{listed(stuck)} of {labels[1]} ended at a bound: widen it before testing."
        )
    # A term that ended at the bound where the smaller model has it adds nothing, and has no error.
    inside = [k for k, name in enumerate(large.free) if name not in stuck]
    rows = [large.free.index(name) for name in stuck]
    H = (place.directions @ _null_space(place.directions[rows]))[inside]
    C = H.T @ np.nan_to_num(covariance[np.ix_(inside, inside)]) @ H
    unknown = np.isnan(np.diag(covariance)) & np.any(place.directions != 0, axis=1)
    unknown[rows] = False
    if unknown.any() or not large.dof > 0 or (H.size and not np.all(np.linalg.eigvalsh(C) > 0)):
        lost = [name for name, gone in zip(large.free, unknown, strict=True) if gone] or place.terms
        raise ValueError(
            f"the data do not determine {listed(list(lost))} of {labels[1]}: nothing can be tested."
        )

    scale = 1.0
    reason = _scaled_for(large)
    has_ratio = len(large.responses) == len(large.parts) or (
        is_likelihood(small) and is_likelihood(large)
    )
    if has_ratio and large.white is not None:
        ratio = _likelihood_ratio(small, large, labels)
        estimated = reason == BEYOND and not any(
            isinstance(p.settings.get("noise"), Mapping) for p in large.parts
        )
        if H.size and not estimated:
            white = H.T @ large.white[np.ix_(inside, inside)] @ H
            scale = float(np.trace(np.linalg.solve(white, C))) / H.shape[1]
        statistic = max(ratio, 0.0) / (scale * r)
        if (
            estimated
        ):  # n log(1 + x), x the relative decrease of the squares, of which F is x (n - p) / r
            numbers = sum(count_numbers(part) for part in large.parts)
            statistic = math.expm1(max(ratio, 0.0) / numbers) * large.dof / r
    else:
        ratio = math.nan
        moved = np.array([large.estimate[name] for name in large.free]) - place.point
        difference = H.T @ moved[inside]
        statistic = float(difference @ np.linalg.solve(C, difference)) / r if H.size else 0.0
    p_value = _p_value(statistic, r, large.dof, on_bound=bool(place.on_bound))
    return NestedTest(
        *labels, place.terms, ratio, scale, statistic, (r, large.dof), p_value, reason
    )


def ratio_test(
    small: Fit, large: Fit, terms: tuple[str, ...], labels: tuple[str, str]
) -> NestedTest:
    """Test a fit against a larger one that is known to contain it, if only as a limit.

    There the larger one has no direction that leaves the smaller, so the scale is the mean over all
    that it determines.
    """
    removed = len(large.free) - len(small.free)
    scale = cost_scale(large)
    if not (large.dof > 0 and scale > 0):
        raise ValueError(
            f"the data leave {labels[1]} no degrees of freedom: nothing can be tested."
        )
    ratio = 2 * (small.cost - large.cost)
    statistic = max(ratio, 0.0) / (scale * removed)
    p_value = _p_value(statistic, removed, large.dof, on_bound=False)
    return NestedTest(
        *labels, terms, ratio, scale, statistic, (removed, large.dof), p_value, _scaled_for(large)
    )


def with_independent_errors(fit: Fit) -> Fit:
    """Return a fit with the covariance and degrees of freedom as if errors were independent along frequency.

    For tests: its quantities keep their errors.
    """
    if fit.independent is None:
        return fit
    covariance, dof = fit.independent
    rows = np.ix_(*[[fit.names.index(name) for name in fit.free]] * 2)
    changed = fit.covariance.copy()
    changed[rows] = np.where(np.isnan(changed[rows]), np.nan, covariance)
    directions = None if fit.directions is None else replace(fit.directions, covariance=covariance)
    return replace(fit, covariance=changed, dof=dof, directions=directions, independent=None)


def cost_scale(fit: Fit) -> float:
    """Return by what twice a difference of costs is divided to be one of log-likelihoods; NaN where it is not known.

    The mean, over the directions that the data determine, of the variance that the standard errors
    say over the one that the curvature of the cost says.
    """
    if fit.white is None or fit.directions is None:
        return math.nan
    size = np.outer(fit.directions.size, fit.directions.size)
    inverse = np.linalg.pinv(fit.white / size, rcond=RANK, hermitian=True)
    rank = int(np.linalg.matrix_rank(inverse, tol=0.0))
    return float(np.trace(inverse @ (fit.directions.covariance / size))) / max(rank, 1)


def _scaled_for(fit: Fit) -> str:
    if any(part.data.has_time for part in fit.records):
        return IN_TIME
    return SIZE if fit.responses else BEYOND


def _null_space(matrix: Array) -> Array:
    """Return orthonormal columns on which a matrix (m, r) of full row rank is zero."""
    _, _, right = np.linalg.svd(matrix)
    return right[len(matrix) :].T


def _labels(small: Fit, large: Fit) -> tuple[str, str]:
    """Return the names of the models; that of one model with fewer parameters free says which."""
    first, second = labels_of((small, large))
    models = [fit.parts[0].label for fit in (small, large)]
    held = [name for name in large.free if name not in small.free and name in small.estimate]
    if models[0] != models[1] or not held:
        return first, second
    kinds = {q.name: q.kind for q in small.quantities}
    stated = [
        f"{', '.join(n for n in held if kinds[n] == kind)} {kind}"
        for kind in dict.fromkeys(map(kinds.get, held))
    ]
    return f"{models[0]} with {' and '.join(stated)}", models[1]


def _likelihood_ratio(small: Fit, large: Fit, labels: tuple[str, str]) -> float:
    ratio = 2 * (small.cost - large.cost)
    if ratio < -max(RATIO_TOLERANCE, RELATIVE_COST_TOLERANCE * abs(large.cost)):
        raise ValueError(
            f"{labels[1]} costs more than {labels[0]}, which it contains: its fit has not found the minimum; "
            "give it more starts."
        )
    return ratio


def _p_value(statistic: float, r: int, dof: float, *, on_bound: bool) -> float:
    """Return the probability of as large a statistic; with a term on its bound, half of it with that term at rest."""
    whole = _upper_tail(r * statistic, r, dof)
    return 0.5 * (whole + _upper_tail(r * statistic, r - 1, dof)) if on_bound else whole


def _upper_tail(total: float, r: int, dof: float) -> float:
    from scipy.special import chdtrc, fdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    if r == 0:
        return float(total <= 0)
    return float(chdtrc(r, total) if math.isinf(dof) else fdtrc(r, dof, total / r))
