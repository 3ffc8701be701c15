"""The covariance of an estimate and what it leaves open, as a value."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, positive_or_one
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.information import Information
from greybox.engine.covariance.combinations import Combination
from greybox.engine.covariance.known_directions import KnownDirections
from greybox.engine.covariance.part_accuracy import (
    PartAccuracy,
)


@frozen
class Accuracy:
    """The covariance of an estimate and what it leaves open.

    Attributes
    ----------
    nlp : CompiledProblem
    x : (p,) array
        The estimate.
    trajectories : (parts,) sequence of Trajectory
        Trajectories of the parts at the estimate; None without an estimate.
    covariance : (k, k) array
        Covariance of the free parameters, then the constants, in the directions that the data
        determine. Constants have the covariance of the earlier fit that they come from, or zero.
    blind : (k, b) array
        Directions, in multiples of `size`, on which the data contain no information: invisible
        ones, and parameters that a bound holds.
    size : (k,) array
        The change of each value that the data notice.
    dof : float
        Numbers in the data less the directions that they determine, and fewer if errors are
        correlated. Infinite if all data have given variances, which records never have.
    shares : tuple of (k, k) array and float
        Contribution of each part and of each earlier fit to the covariance, with its degrees of
        freedom.
    combinations : tuple of Combination
        Combinations that the data do not determine, or determine poorly.
    at_bound : tuple of str
        Free parameters that ended at a bound.
    active : tuple of str
        Constraints, and bounds of tied parameters, that hold with equality.
    bias : (k,) array
        Bias of the estimate from the magnitude by which a criterion divides, see
        `AnyCriterion.gain_bias`; without the bias of an earlier fit.
    systematic : (k, m) array
        What one standard deviation of each of the errors that points of a response have in common
        changes in the estimate: the covariance contains its product with itself.
    white : (p, p) array or None
        The covariance of the free parameters if the cost were the likelihood of white errors: the
        inverse bread.
    independent : (p, p) array and float, or None
        Covariance of the free parameters, and degrees of freedom, if the errors of responses were
        independent along frequency; None where they are.
    informations : (parts,) tuple of Information
        Information of every part.
    parts : (parts,) tuple of PartAccuracy
        Errors of every part; empty where no degrees of freedom are left.
    """

    nlp: CompiledProblem
    x: Array
    trajectories: Sequence[Any]
    covariance: Array
    blind: Array
    size: Array
    dof: float
    bias: Array
    systematic: Array
    shares: tuple[tuple[Array, float], ...] = ()
    combinations: tuple[Combination, ...] = ()
    at_bound: tuple[str, ...] = ()
    active: tuple[str, ...] = ()
    white: Array | None = None
    independent: tuple[Array, float] | None = None
    informations: tuple[Information, ...] = ()
    parts: tuple["PartAccuracy", ...] = ()

    @classmethod
    def unknown(cls, nlp: CompiledProblem) -> "Accuracy":
        """Return the accuracy of a fit without an estimate: NaN everywhere."""
        k = len(nlp.names)
        return cls(
            nlp,
            np.full(len(nlp.free), np.nan),
            [None] * len(nlp.parts),
            covariance=np.full((k, k), np.nan),
            blind=np.zeros((k, 0)),
            size=np.ones(k),
            dof=0.0,
            bias=np.zeros(k),
            systematic=np.zeros((k, 0)),
        )


def degrees(accuracy: Accuracy, gradient: Array) -> Array:
    """Return the degrees of freedom of quantities from their gradient (m, k): (m,).

    A variance Σ vᵢ whose parts have νᵢ degrees of freedom has (Σ vᵢ)² / Σ (vᵢ²/νᵢ).
    Source: Welch (1947), Biometrika 34; Satterthwaite (1946), Biometrics Bulletin 2.
    """
    if not accuracy.shares:
        return np.full(len(gradient), accuracy.dof)
    v = np.array([np.einsum("ij,jk,ik->i", gradient, c, gradient) for c, _ in accuracy.shares])
    spread = 1 / np.array([dof for _, dof in accuracy.shares]) @ v**2
    return np.where(spread > 0, v.sum(axis=0) ** 2 / positive_or_one(spread), math.inf)


def propagate(accuracy: Accuracy, gradient: Array) -> Array:
    """Return the standard errors (m,) of quantities from their gradients (m, k) by all values.

    NaN for a quantity that depends on a direction on which the data contain no information.
    """
    return KnownDirections(
        accuracy.covariance, accuracy.blind, accuracy.size, accuracy.size
    ).errors(gradient)
