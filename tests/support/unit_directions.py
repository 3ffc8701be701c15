"""Errors that are correlated in time, for parameters whose covariance is not one."""

from dataclasses import replace

import numpy as np


def of_unit_variance(weighted, inverse):
    """Sensitivities by directions of unit variance, where `inverse` is the covariance of the parameters."""
    root = np.linalg.cholesky(inverse)
    return [np.einsum("kpn,pq->kqn", J, root) for J in weighted]


def with_states(weighted, initial=None, shocks=None):
    """Sensitivities by the initial states and jumps of the states, by default of none."""
    nothing = [np.zeros((len(J), 0, J.shape[2])) for J in weighted]
    longest = max(nothing, key=lambda X: X.shape[2])
    return initial or nothing, shocks or (lambda: longest)


def by_parameters(function, weighted, residuals, inverse, *more, **states):
    """What a function finds of the errors, with its meat by the parameters of this covariance."""
    root = np.linalg.cholesky(inverse)
    initial, shocks = with_states(weighted, **states)
    found = function(weighted, root, residuals, *more, initial=initial, shocks=shocks)
    back = np.linalg.inv(root)
    return replace(found, meat=back.T @ found.meat @ back)
