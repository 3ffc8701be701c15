"""Whether the terms that one model has more than another are needed."""

import math
from dataclasses import dataclass

import numpy as np

from greybox.data.text_table import number, one_line
from greybox.estimate.result import Fit
from greybox.validation.comparison import SIGNIFICANT, p_text
from greybox.validation.same_data import check_fits, data_difference, is_likelihood, labels_of, other_samples

# How far twice the log-likelihood of the larger model may lie below that of the smaller: 1e-3, where 3.84 is
# significant at 5 %, or what solvers leave of a large cost, 1e-9 of it.
RATIO_TOLERANCE = 1e-3
RELATIVE_COST_TOLERANCE = 1e-9


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
        Twice the difference of the negative log-likelihoods; NaN where the criterion is no likelihood.
    scale : float
        By how much the correlation of the residuals in time inflates it; 1 for white residuals.
    statistic : float
        What is compared with the F distribution.
    dof : (float, float)
        Its degrees of freedom; the second is `Fit.dof` of the larger.
    p_value : float
    """

    small: str
    large: str
    terms: tuple[str, ...]
    likelihood_ratio: float
    scale: float
    statistic: float
    dof: tuple[float, float]
    p_value: float

    def __repr__(self) -> str:
        return one_line(self, f"{self.small} in {self.large}", p_text(self.p_value))

    def __str__(self) -> str:
        names = ", ".join(self.terms)
        verb = "is" if len(self.terms) == 1 else "are"
        if self.p_value < SIGNIFICANT:
            verdict = f"{names} {verb} needed: {self.small} is rejected by the test against {self.large}"
        else:
            verdict = f"{names} {verb} not needed: {self.small} explains the data as well as {self.large}"

        numerator, denominator = self.dof
        if math.isinf(denominator):
            statistic = f"chi2({numerator:g}) = {number(self.statistic * numerator, 4)}"
        else:
            statistic = f"F({numerator:g}, {denominator:.0f}) = {number(self.statistic, 4)}"

        method = "Wald test with the standard errors of the fit"
        if not math.isnan(self.likelihood_ratio):
            method = (
                f"likelihood ratio {number(self.likelihood_ratio, 4)}, divided by {number(self.scale, 3)} for "
                "residuals that are correlated in time"
            )
        return f"{verdict} ({statistic}, {p_text(self.p_value)}; {method})."


def nested_test(small: Fit, large: Fit) -> NestedTest:
    """Test whether the parameters that `large` has free and `small` has not are needed.

    The likelihood ratio is divided by the factor by which correlation of the residuals in time inflates the variance
    of these parameters, so that the test keeps its size there (the mean of the scaled statistic is that of chi-square,
    over its degrees of freedom F). Where the cost is no likelihood, the estimates of these parameters are compared with
    their values in `small` by their covariance (Wald).

    Raises
    ------
    ValueError
        If the data differ, the free parameters of `small` are not among those of `large`, or `large` costs more.

    Sources: Rotnitzky and Jewell (1990), Biometrika 77; Satorra and Bentler (1994); Klein and Morelli, chapter 5.
    """
    check_fits((small, large))
    labels = _labels(small, large)
    different = data_difference((small, large), labels) or other_samples((small, large), labels)
    if different:
        raise ValueError(f"{different}: a nested test needs fits of the same data.")
    terms = _terms(small, large, labels)

    covariance = large.covariance_of(terms)
    if not np.all(np.isfinite(covariance)):
        raise ValueError(f"the data do not determine {', '.join(terms)} of {labels[1]}: nothing can be tested.")

    r = len(terms)
    if is_likelihood(small) and is_likelihood(large) and large.white is not None:
        ratio = _likelihood_ratio(small, large, labels)
        places = [large.free.index(name) for name in terms]
        white = large.white[np.ix_(places, places)]
        scale = float(np.trace(np.linalg.solve(white, covariance))) / r
        statistic = max(ratio, 0.0) / (scale * r)
    else:
        ratio = math.nan
        scale = 1.0
        difference = np.array([large.estimate[name] - small.estimate.get(name, 0.0) for name in terms])
        statistic = float(difference @ np.linalg.solve(covariance, difference)) / r
    p_value = _p_value(statistic, r, large.dof)
    return NestedTest(*labels, terms, ratio, scale, statistic, (r, large.dof), p_value)


def _labels(small: Fit, large: Fit) -> tuple[str, str]:
    """Return the names of the models; that of one model with fewer parameters free says which."""
    first, second = labels_of((small, large))
    models = [fit.parts[0].label for fit in (small, large)]
    held = [name for name in large.free if name not in small.free and name in small.estimate]
    if models[0] != models[1] or not held:
        return first, second
    return f"{models[0]} with {', '.join(held)} fixed", models[1]


def _terms(small: Fit, large: Fit, labels: tuple[str, str]) -> tuple[str, ...]:
    if not set(small.free) < set(large.free):
        raise ValueError(
            f"{labels[0]} (free: {', '.join(small.free)}) is not {labels[1]} (free: {', '.join(large.free)}) with "
            "terms removed: fix or leave out parameters of the larger, and compare others with gb.compare."
        )
    return tuple(name for name in large.free if name not in small.free)


def _likelihood_ratio(small: Fit, large: Fit, labels: tuple[str, str]) -> float:
    ratio = 2 * (small.cost - large.cost)
    if ratio < -max(RATIO_TOLERANCE, RELATIVE_COST_TOLERANCE * abs(large.cost)):
        raise ValueError(
            f"{labels[1]} costs more than {labels[0]}, which it contains: its fit has not found the minimum; "
            "give it more starts."
        )
    return ratio


def _p_value(statistic: float, r: int, dof: float) -> float:
    from scipy.special import chdtrc, fdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    return float(chdtrc(r, r * statistic) if math.isinf(dof) else fdtrc(r, dof, statistic))
