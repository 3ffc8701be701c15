"""Whether the data contradict the a-priori knowledge."""

import math
from collections.abc import Iterator

from greybox.estimate.result import Fit
from greybox.files.text_table import number, with_error


def prior_conflicts(fit: Fit) -> Iterator[str]:
    """Warn of parameters that the data moved further than their priors allow.

    If prior and data agree, the mean moves by a normal amount with the variance that the prior has
    more than the estimate. Source: Evans and Moshonov (2006), Checking for prior-data conflict,
    Bayesian Analysis 1(4), for normal densities.
    """
    for name, (mean, sigma) in fit.priors.items():
        error = fit.standard_error.get(name, math.nan)
        # Without an error below that of the prior, the data told nothing of the parameter.
        if not error < sigma:
            continue

        deviations = abs(fit.estimate[name] - mean) / math.sqrt(sigma**2 - error**2)
        if deviations > 3:
            value, deviation = with_error(mean, sigma)
            yield (
                f"the data contradict the prior of {name}, {value} ± {deviation}: the estimate "
                f"{number(fit.estimate[name])} is {number(deviations, 2)} standard deviations "
                "away. Check the prior and the model."
            )
