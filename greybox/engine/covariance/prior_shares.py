"""The share of priors in the information on each parameter."""

import math

import numpy as np

from greybox.data.files.named_values import Values
from greybox.engine.covariance.accuracy import Accuracy, propagate
from greybox.engine.covariance.part_accuracy import (
    share_of,
)


def prior_shares(accuracy: Accuracy) -> Values:
    """Return the share of priors in the information on each free parameter, by name.

    The other parameters are estimated too, and errors are taken as independent. NaN for a parameter
    without a standard error; empty without a prior.
    """
    nlp = accuracy.nlp
    p = len(nlp.free)
    is_prior = [part.problem.criterion.is_prior for part in nlp.parts]
    if not any(is_prior):
        return {}
    if accuracy.white is None:
        return dict.fromkeys(nlp.free, math.nan)

    information = np.array(
        [
            np.linalg.norm(share_of(part, p).root[:, :p] @ accuracy.white, axis=0) ** 2
            for part in accuracy.informations
        ]
    )
    share = information[is_prior].sum(0) / np.maximum(information.sum(0), 1e-300)
    share[np.isnan(propagate(accuracy, np.eye(p, len(nlp.names))))] = math.nan
    return dict(zip(nlp.free, share.tolist(), strict=True))
