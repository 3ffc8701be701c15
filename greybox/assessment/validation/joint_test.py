"""The joint test of several parameters of one fit: whether the data need any of them."""

from collections.abc import Sequence

import numpy as np

from greybox.assessment.result import Fit
from greybox.assessment.validation.comparison import SIGNIFICANT
from greybox.assessment.validation.nested_models import f_tail
from greybox.data.files.argument_checks import as_names
from greybox.data.files.arrays import Array, all_finite
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values, array_of
from greybox.data.files.numbers_in_text import number, p_text
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.wording import listed
from greybox.modeling.model import require_known

# Directions in which a prior has more of the information are left out of the test: there, the
# estimate of the data alone is far off and says little.
DATA_SHARE = 0.5


@public
@frozen
class JointTest(Printed):
    """Whether several parameters together differ from stated values; printed, it is a sentence.

    Attributes
    ----------
    names : tuple of str
    effective : float
        Degrees of freedom that the data spend on them: their number without a prior, less with one.
    statistic : float
        Compared with the F distribution.
    dof : (int, float)
        Degrees of freedom of that distribution: tested directions, and those of the errors.
    p_value : float
        Probability of as large a statistic if all had the stated values.
    """

    names: tuple[str, ...]
    effective: float
    statistic: float
    dof: tuple[int, float]
    p_value: float

    def __str__(self) -> str:
        verdict = "differ from" if self.p_value < SIGNIFICANT else "are not shown to differ from"
        first, second = self.dof
        return (
            f"{listed(self.names)} together {verdict} the stated values (F({first}, {second:.0f}) "
            f"= {number(self.statistic, 4)}, {p_text(self.p_value)}); the data spend "
            f"{number(self.effective, 2)} degrees of freedom on them."
        )


@public
def joint_test(fit: Fit, names: Sequence[str], values: Values | None = None) -> JointTest:
    """Test whether several parameters of a fit together differ from stated values.

    It answers whether a term of several weights is needed. Unlike `nested_test` it asks for one
    fit alone, and it allows priors: the test is that of the estimate that the data alone would
    give, in the directions in which they have more information than the priors. Priors are taken
    as independent of one another.

    Parameters
    ----------
    fit : Fit
    names : sequence of str
        Free parameters.
    values : mapping of name to float, optional
        What they are compared with; zero for those without a value.

    Raises
    ------
    ValueError
        For names that are not free, or parameters without a standard error.

    Source: Seber and Wild (1989), Nonlinear Regression, section 5.3; Wood (2013), Biometrika 100,
    for terms with priors.
    """
    fit.require_estimate()
    tested = as_names(names)
    require_known(tested, fit.free, "free parameter", f"the fit {fit.name!r}")
    stated = values or {}
    require_known(stated, tested, "tested parameter", "values")
    if not tested:
        raise ValueError(
            "names is empty: give the parameters to test, such as the weights of a term."
        )
    covariance = fit.covariance_of(tested)
    if not all_finite(covariance):
        raise ValueError(
            f"the data do not determine {listed(tested)}: a joint test needs parameters with "
            "standard errors."
        )

    null = np.array([stated.get(name, 0.0) for name in tested])
    away = array_of(fit.estimate, tested) - null
    prior_mean, prior_information = _priors(fit, tested)

    # In units in which the posterior has unit covariance: the data have a share of the information
    # along each direction, and the prior has the rest.
    root = np.linalg.cholesky(covariance)
    shares, directions = np.linalg.eigh(np.eye(len(tested)) - root.T @ prior_information @ root)
    shares = np.clip(shares, 0.0, 1.0)
    pull = np.linalg.solve(root, away) - root.T @ prior_information @ (prior_mean - null)
    by_direction = directions.T @ pull

    used = shares > DATA_SHARE
    rank = int(used.sum())
    if not rank:
        raise ValueError(
            f"the priors say more about {listed(tested)} than the data do, which can show nothing."
        )
    statistic = float(np.sum(by_direction[used] ** 2 / shares[used]) / rank)
    dof = rank, fit.fewest_degrees(tested)
    return JointTest(tested, float(shares.sum()), statistic, dof, f_tail(statistic, *dof))


def _priors(fit: Fit, names: Sequence[str]) -> tuple[Array, Array]:
    """Return the means (k,) of the priors of parameters, and their information (k, k)."""
    mean, information = np.zeros(len(names)), np.zeros(len(names))
    for place, name in enumerate(names):
        if name in fit.priors:
            mean[place], deviation = fit.priors[name]
            information[place] = 1 / deviation**2
    return mean, np.diag(information)
