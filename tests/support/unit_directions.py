"""Errors that are correlated in time, for parameters whose covariance is not one."""

from dataclasses import replace

import numpy as np


def of_unit_variance(weighted, inverse):
    """Sensitivities by directions of unit variance, where `inverse` is the covariance of the parameters."""
    root = np.linalg.cholesky(inverse)
    return [np.einsum("kpn,pq->kqn", J, root) for J in weighted]


def by_parameters(function, weighted, residuals, inverse, *more, **options):
    """What a function finds of the errors, with its meat by the parameters of this covariance."""
    root = np.linalg.cholesky(inverse)
    found = function(weighted, root, residuals, *more, **options)
    back = np.linalg.inv(root)
    return replace(found, meat=back.T @ found.meat @ back)
