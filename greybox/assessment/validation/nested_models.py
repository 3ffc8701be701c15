"""The test of nested models: whether the data need the terms that only the larger model has."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from greybox.assessment.fitted_part import FittedPart, FittedResponse
from greybox.assessment.result import Fit
from greybox.assessment.validation.comparison import SIGNIFICANT
from greybox.assessment.validation.nesting import NotNestedError, nested_values
from greybox.assessment.validation.same_data import (
    check_fits,
    count_unknowns,
    data_difference,
    is_likelihood,
    labels_of,
    other_samples,
)
from greybox.data.files.argument_checks import require_kind
from greybox.data.files.arrays import all_finite
from greybox.data.files.named_values import Values, places_of
from greybox.data.files.numbers_in_text import number, p_text
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.wording import listed
from greybox.modeling.formulation.error_covariance import is_estimated


@public
@dataclass(frozen=True, repr=False)
class NestedTest(Printed):
    """Whether the data need the terms that only the larger model has; printed, it is a sentence.

    Attributes
    ----------
    small, large : str
        Labels of the models.
    terms : tuple of str
        The parameters that are free only in the larger model.
    likelihood_ratio : float
        Twice the difference of the costs.
    scale : float
        Divisor of the ratio: the factor by which correlated residuals inflate it, or the size of
        the errors on the scale of the criterion.
    statistic : float
        The number that is compared with the F distribution.
    dof : (float, float)
        Degrees of freedom of that distribution; the second is `Fit.dof` of the larger fit.
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

    def __str__(self) -> str:
        verb = "is" if len(self.terms) == 1 else "are"
        rejected = f"rejected by the test against {self.large}"
        if self.p_value < SIGNIFICANT:
            verdict = f"{verb} needed: {self.small} is {rejected}"
        # With fewer than three degrees of freedom, F of one term is significant only above 18.
        elif self.dof[1] < 3 or f_tail(self.statistic, round(self.dof[0]), math.inf) < SIGNIFICANT:
            # The same ratio would be significant with more degrees of freedom.
            verdict = (
                f"may be needed: the residuals are too correlated, or too few, to tell "
                f"{self.small} from {self.large}"
            )
        else:
            verdict = f"{verb} not shown to be needed: {self.small} is not {rejected}"

        r, dof = self.dof
        statistic = f"F({r:g}, {dof:.0f}) = {number(self.statistic, 4)}"
        scale = "" if self.scale == 1.0 else f"; scaled by {number(self.scale, 3)}"
        return f"{', '.join(self.terms)} {verdict} ({statistic}, {p_text(self.p_value)}{scale})."


@public
def nested_test(small: Fit, large: Fit, *, at: Values | None = None) -> NestedTest:
    """Test whether the parameters that only `large` has free are needed.

    `large` contains `small` if `small` fixes or ties these parameters of the same model; if the
    formulas of both models are the same where the parameters that only `large` has are zero; or
    where its class (`Model.contains`) or you state it.

    The test compares twice the difference of the costs with an F distribution. First it divides by
    the variance that the standard errors give these parameters over the variance that the curvature
    of the cost implies, so that it keeps its size where residuals are correlated. For rows without
    a time it is the F test of least squares. Where one of the values is on a bound, half of the
    distribution has one degree of freedom less; where several are, the p-value is an upper limit.
    Process noise is tested in the same way: `OutputError` against
    `PredictionError(process_noise=...)`.

    Parameters
    ----------
    small, large : Fit
        Fits of the same data.
    at : mapping of name to float, optional
        Values at which the model of `large` is that of `small`, such as ``{"n": 1.0}``, for
        parameters that the model of `small` lacks; zero for those that are not named. They only
        decide whether a value is on a bound.

    Raises
    ------
    ValueError
        If the data differ, `small` is not shown to be `large` with terms removed, the costs have no
        likelihood ratio, or `large` costs more.
    LookupError
        If a loaded fit does not know its model.

    Sources: Rotnitzky and Jewell (1990), Biometrika 77; Satorra and Bentler (1994); Klein and
    Morelli, chapter 5; Self and Liang (1987), Journal of the American Statistical Association 82.
    """
    fits = small, large
    check_fits(fits)
    require_kind("at", at, Mapping | None, "{name: value}")
    small_label, large_label = labels_of(fits)
    labels = small_label, large_label
    different = data_difference(fits, labels) or other_samples(fits, labels)
    if different:
        raise ValueError(f"{different}: a nested test needs fits of the same data.")

    try:
        values = nested_values(small, large, labels, at or {})
    except NotNestedError as reason:
        raise ValueError(
            f"{small_label} is not shown to be {large_label} with terms removed: {reason}. Use "
            "gb.compare, which needs no nesting."
        ) from None
    return nested_test_at(values, small, large, labels)


def nested_test_at(
    values: Values,
    small: Fit,
    large: Fit,
    labels: tuple[str, str],
    *,
    independent: bool = False,
) -> NestedTest:
    """Test a fit against a larger one that is the same model where its terms have these `values`.

    With `independent`, errors count as independent along frequency, and as of equal size if `large`
    does not explain the data.

    Raises
    ------
    ValueError
        If the data do not determine the terms, there is no likelihood ratio, or `large` costs more.
    """
    small_label, large_label = labels
    on_bound = set()
    for name, value in values.items():
        bounds = large.by_name[name].bounds
        if any(math.isclose(value, bound, rel_tol=1e-9) for bound in bounds):
            on_bound.add(name)
    # A term that ended at another bound may explain more beyond it: the ratio would be too small.
    ended_at_bound = {name for name in values if large.by_name[name].at_bound}
    if not ended_at_bound <= on_bound:
        raise ValueError(
            f"{listed(sorted(ended_at_bound))} of {large_label} ended at a bound: widen it before "
            "testing."
        )
    # A term that ended at the bound where the smaller model has it adds nothing, and has no error.
    terms = [name for name in large.free if name in values and name not in ended_at_bound]
    rows = places_of(terms, large.free)
    covariance = large.covariance_of(terms)
    dof = large.dof
    if independent and large.independent is not None:
        independent_covariance, dof = large.independent
        of_terms = independent_covariance[np.ix_(rows, rows)]
        covariance = np.where(np.isnan(covariance), np.nan, of_terms)
    if not (dof > 0 and all_finite(covariance) and np.all(np.linalg.eigvalsh(covariance) > 0)):
        raise ValueError(
            f"the data do not determine {listed(list(values))} of {large_label}: nothing can be "
            "tested."
        )
    are_responses = len(large.responses) == len(large.parts)
    are_likelihoods = is_likelihood(small) and is_likelihood(large)
    if large.white is None or not (are_responses or are_likelihoods):
        raise ValueError(f"the costs of {small_label} and {large_label} have no likelihood ratio.")

    removed = count_unknowns(large) - count_unknowns(small)
    ratio = _likelihood_ratio(small, large, labels)
    # If all terms ended at the bound where the smaller model has them, the models are the same, and
    # the ratio is rounding. Its sign must not decide: at zero, the probability jumps from one to a
    # half.
    gain = max(ratio, 0.0) if terms else 0.0
    scale = 1.0
    if all(_estimates_variance(part) for part in large.parts):
        # The variance is estimated: the ratio is n log(1 + x) of the relative decrease x of the
        # squares, for which F is x (n - p) / r.
        numbers = sum(part.compared_numbers for part in large.parts)
        statistic = math.expm1(gain / numbers) * dof / removed
    else:
        if terms:
            white = large.white[np.ix_(rows, rows)]
            scale = float(np.trace(np.linalg.solve(white, covariance))) / len(terms)
        if independent and not large.is_explained:
            # Where a misfit counts as noise, the noise of the responses that lack another term is
            # so large that no term of theirs would be found: errors count as equal.
            scale = 1.0 if is_likelihood(large) or math.isinf(dof) else 2 * large.cost / dof
        statistic = gain / (scale * removed)
    return NestedTest(
        small=small_label,
        large=large_label,
        terms=tuple(values),
        likelihood_ratio=ratio,
        scale=scale,
        statistic=statistic,
        dof=(removed, dof),
        p_value=f_tail(statistic, removed, dof, on_bound=bool(on_bound)),
    )


def cost_scale(fit: Fit) -> float:
    """Return the divisor of twice a difference of costs for log-likelihoods; NaN if unknown.

    It is the mean, over the directions that the data determine, of the variance by the standard
    errors, for errors that are independent along frequency, over the variance by the curvature of
    the cost.
    """
    if fit.white is None or fit.directions is None:
        return math.nan
    directions = fit.directions.of(range(len(fit.free)))
    size = np.outer(directions.size, directions.size)
    # The covariance is zero, but for rounding, in directions that the data do not determine.
    inverse = np.linalg.pinv(fit.white / size, rcond=1e-14, hermitian=True)
    rank = int(np.linalg.matrix_rank(inverse, tol=0.0))
    covariance = directions.covariance
    if fit.independent is not None:
        covariance, _ = fit.independent
    return float(np.trace(inverse @ (covariance / size))) / max(rank, 1)


def f_tail(statistic: float, r: int, dof: float, *, on_bound: bool = False) -> float:
    """Return the probability of a larger statistic, F with r and `dof` degrees of freedom."""
    from scipy.special import fdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    dof = min(dof, 1e9)  # F is then chi-square / r to all digits
    p_value = float(fdtrc(r, dof, statistic))
    if not on_bound:
        return p_value
    # If a term is truly on its bound, in half of all experiments the estimate stays there, and the
    # ratio has one degree of freedom less (Self and Liang).
    fewer = float(fdtrc(r - 1, dof, statistic * r / (r - 1))) if r > 1 else float(statistic <= 0)
    return 0.5 * (p_value + fewer)


def _estimates_variance(part: FittedPart) -> bool:
    """Return whether the data of a part are rows or lines of a variance that the fit estimates."""
    if isinstance(part, FittedResponse) or getattr(part.data, "has_time", False):
        return False
    return is_estimated(part.settings.get("noise"))


def _likelihood_ratio(small: Fit, large: Fit, labels: tuple[str, str]) -> float:
    """Return twice the difference of the costs; raise ValueError if the larger model costs more."""
    ratio = 2 * (small.cost - large.cost)
    # The two fits may have been integrated with different steps, which may change the ratio by
    # 0.02, while 3.84 is significant. The tolerance of the solvers is 1e-9 of a large cost.
    if ratio < -max(0.02, 1e-9 * abs(large.cost)):
        # The filter of little process noise may settle more slowly than a short record lasts: the
        # fit then ends above zero.
        unless = (
            "these data show no process noise, or "
            if any(part.driven for part in large.records)
            else ""
        )
        raise ValueError(
            f"{labels[1]} costs more than {labels[0]}, which it contains: {unless}its fit has not "
            "reached the minimum; give it more starts."
        )
    return ratio
