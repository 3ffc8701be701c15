"""Condensing: the elimination of nodes and continuity multipliers from the Gauss-Newton system.

The Karush-Kuhn-Tucker system of a chain of segments is banded: each segment is coupled to the next
by its end state alone. It is solved for several right-hand sides at once: one for the residuals,
and one for each parameter. The solutions are the sensitivities of nodes and multipliers to the
parameters. With them only a small system in the parameters remains.

Source: Bock and Plitt (1984), A multiple shooting algorithm for direct solution of optimal control
problems, IFAC Proceedings 17(2); Betts (2010), Practical Methods for Optimal Control and
Estimation, 2nd ed., chapter 4.
"""

from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, all_finite, diagonal, positive_or_one
from greybox.engine.compiled.part import Condensed, Trajectory
from greybox.engine.compiled.sampled_data import SampledData
from greybox.engine.compiled.segments import Linearization, Segments

# Curvature that is added for initial states without effect on any output, relative to the curvature
# of the outputs.
RIDGE = 1e-10

# A chain with at least this many nodes times states is halved. For a shorter one, the banded system
# takes less time.
LONG_CHAIN = 500

# Largest change of a state that a unit change of another state may cause over joined segments: the
# change multiplies rounding errors.
MOST_GROWTH = 1e4

# Variance, in units of the largest one allowed, above which a direction of the initial states is
# weakly observable.
WEAK_VARIANCE = 4

# Penalty on such a direction: a step along it becomes shorter than 1e-8 of its length.
STIFFNESS = 1e8


def condense(
    linearization: Linearization,
    trajectory: Trajectory,
    variance: Array,
    damping: float,
    data: SampledData,
    segments: Segments,
    largest: Array | None = None,
) -> Condensed:
    """Return the quadratic model in the solver's variables, with all nodes eliminated.

    Continuity is exact where its `variance` (n,) is zero. `damping` is the Levenberg-Marquardt term
    of the free nodes, relative to their curvature. Initial states whose variances exceed `largest`
    (n,), if given, get a stiff penalty.
    """
    held = np.zeros(1)  # no penalty: it broadcasts against (s, n, n)
    if largest is not None:
        held = _held_curvature(linearization, variance, data, largest)
    node_hessian = linearization.node_hessian + held
    # Damping enters the matrix but not the gradient: a minimum of the problem stays one. Without
    # it, 91 % of 58 fits of hard problems reach the best minimum instead of 97 %.
    node_damping = np.zeros_like(trajectory.gaps)
    if damping:
        node_damping = damping * _node_curvature(linearization, variance, data)
        node_hessian += diagonal(node_damping)

    # The first right-hand side is the gradient of the residuals, the others are its derivatives
    # with respect to the parameters. They have no names, so that their memory is freed early.
    nodes, multiplier = solve_continuity(
        node_hessian,
        linearization.transition,
        data.coupled,
        -np.concatenate(
            [linearization.node_gradient[:, :, None], linearization.cross_hessian], axis=2
        ),
        -np.concatenate([trajectory.gaps[:, :, None], linearization.parameter_sensitivity], axis=2),
        variance,
    )

    # The last segment of a stretch has no continuity equation: its multiplier is zero.
    change: Any = 0
    for batch in segments.batches():
        by_nodes = linearization.cross_hessian[batch].mT @ nodes[batch]
        by_multipliers = linearization.parameter_sensitivity[batch].mT @ multiplier[batch]
        change = change + segments.by_record(by_nodes + by_multipliers, batch)
    hessian = linearization.parameter_hessian + change[:, :, 1:]
    gradient = linearization.parameter_gradient + change[:, :, 0]

    # The change of the merit that the quadratic model predicts for a step of the nodes only. It
    # leaves out the damping, because the prediction is compared with the true merit.
    step, node_sensitivity = nodes[:, :, 0], nodes[:, :, 1:]
    curved = np.einsum("si,sij,sj->", step, linearization.node_hessian, step)
    predicted = float((linearization.node_gradient * step).sum() + 0.5 * curved)
    relaxed = variance > 0
    next_gaps = (variance * multiplier[:, :, 0])[:, relaxed]
    change_of_squares = next_gaps**2 - trajectory.gaps[:, relaxed] ** 2
    predicted += 0.5 * float((change_of_squares / variance[relaxed]).sum())

    hessian = (hessian + hessian.mT) / 2
    slope = trajectory.detail.slope
    slopes = np.broadcast_to(slope, (segments.number, *slope.shape[-2:]))
    return Condensed(
        hessian=(slopes.mT @ hessian @ slopes).sum(axis=0),
        gradient=np.einsum("rqz,rq->z", slopes, gradient),
        node_step=step,
        node_sensitivity=node_sensitivity @ slopes[segments.records],
        multiplier=multiplier[:, :, 0],
        multiplier_sensitivity=multiplier[:, :, 1:] @ slopes[segments.records],
        damping=node_damping,
        held=held,
        decrease=max(-predicted, 0.0),
    )


def _held_curvature(
    linearization: Linearization, variance: Array, data: SampledData, largest: Array
) -> Array:
    """Return a penalty (s, n, n) on weakly observable directions of the initial states.

    A direction is weakly observable if its variance at known parameters exceeds four times the
    `largest` variance (n,). The penalty is zero, (1,), if there is no such direction.
    """
    # Steps along such a direction leave the region in which the linearization is valid: runs would
    # make thousands of short steps, and only fit the noise.
    size = np.sqrt(positive_or_one(largest))  # the states of delays are known
    begins = data.begins_stretch
    # For most models the outputs of the first segments are enough information.
    information = np.linalg.eigvalsh(linearization.node_hessian[begins] * size * size[:, None])
    if information.min(initial=1.0) > 1 / WEAK_VARIANCE:
        return np.zeros(1)
    curvature = np.zeros_like(linearization.node_hessian)
    forces = begins[:, None, None] * np.diag(1 / size)
    response, _ = solve_continuity(
        linearization.node_hessian,
        linearization.transition,
        data.coupled,
        forces,
        np.zeros_like(forces),
        variance,
    )
    covariance = response[begins] / size[:, None]
    variances, directions = np.linalg.eigh(covariance)
    # The limit is above one, because a state that decays within a sample has about the largest
    # variance, and needs no penalty.
    is_weak = variances > WEAK_VARIANCE
    directions *= is_weak[:, None] / size[:, None]
    curvature[begins] = STIFFNESS * directions @ directions.mT
    return curvature


def _node_curvature(linearization: Linearization, variance: Array, data: SampledData) -> Array:
    """Return the curvature (s, n) of outputs and continuity penalty for every free node state.

    Where continuity is exact the first nodes of every stretch are free.
    """
    curvature = np.linalg.diagonal(linearization.node_hessian)
    relaxed = variance > 0
    curvature = np.where(data.begins_stretch[:, None] | relaxed, curvature, 0.0)
    stiffness = np.divide(1.0, variance, out=np.zeros_like(variance), where=relaxed)
    coupled = data.coupled[:, None]
    penalty = np.where(coupled, (linearization.transition**2 * stiffness[:, None]).sum(axis=1), 0.0)
    penalty[1:] += np.where(coupled[:-1], stiffness, 0.0)
    return curvature + penalty


def solve_continuity(
    hessian: Array,
    transition: Array,
    coupled: BoolArray,
    stationarity: Array,
    continuity: Array,
    variance: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Solve the Karush-Kuhn-Tucker system of a chain of s segments with n states.

    There are r right-hand sides.

    H_j x_j + A_jᵀ λ_j - λ_(j-1) = stationarity_j and A_j x_j - x_(j+1) - P λ_j = continuity_j, with
    λ_j = 0 where segment j is not `coupled` to the next. P = diag(variance) is zero for exact
    continuity; otherwise continuity is a penalty gap²/2P. In the order x_0, λ_0, x_1, λ_1 ... the
    system is banded, and the time is linear in s.

    Parameters
    ----------
    hessian, transition : (s, n, n) arrays
        H and A.
    coupled : (s,) bool array
    stationarity, continuity : (s, n, r) arrays
    variance : (n,) array, optional
        Exact continuity by default.

    Returns
    -------
    x, λ : (s, n, r) arrays

    Raises
    ------
    numpy.linalg.LinAlgError
        If the system is singular.
    """
    s, n, r = stationarity.shape
    if n == 0:
        return np.zeros((s, 0, r)), np.zeros((s, 0, r))
    size = state_sizes(hessian, transition)
    linked = coupled[:, None, None]
    H = hessian * size * size[:, None]
    # All later nodes follow from the first ones. A mean over all segments may be too large for the
    # first segments: the larger size keeps the ridge negligible against the outputs.
    begins = ~np.append(False, coupled[:-1])
    initial_size = np.maximum(size, state_sizes(hessian[begins], transition[begins]))
    H[begins] += RIDGE * np.diag((size / initial_size) ** 2)
    A = np.where(linked, transition * size / size[:, None], 0.0)
    x = stationarity * size[:, None]
    multiplier = np.where(linked, continuity / size[:, None], 0.0)
    del hessian, stationarity, continuity  # of a long record, a tenth of the memory
    variance = np.broadcast_to(variance, n) / size**2

    # Two neighboring segments of a long chain with exact continuity become one, as often as
    # possible: the second node follows from the first. That takes a fifth of the time of the banded
    # system. All is done in place: fresh memory for copies would take as long as the arithmetic.
    remaining = np.arange(s)
    pairs = list[Any]()
    coupled = coupled.copy()
    while len(remaining) * n >= LONG_CHAIN and not variance.any():
        paired = 2 * np.flatnonzero(coupled[:-1:2])
        first, second = remaining[paired], remaining[paired + 1]
        A_first, A_second, H_second, gap = A[first], A[second], H[second], multiplier[first]
        joined = A_second @ A_first
        # Nodes that are far apart do not determine an unstable trajectory between them.
        if not (len(paired) and np.abs(joined).max() < MOST_GROWTH):
            break
        H[first] += A_first.mT @ H_second @ A_first
        A[first] = joined
        x[first] += A_first.mT @ (x[second] + H_second @ gap)
        multiplier[first] = multiplier[second] + A_second @ gap
        pairs.append((first, second, A_first, gap))
        coupled[paired] = coupled[paired + 1]
        is_kept = np.ones(len(remaining), bool)
        is_kept[paired + 1] = False
        remaining, coupled = remaining[is_kept], coupled[is_kept]

    x[remaining], multiplier[remaining] = _solved_bands(
        coupled, variance, H[remaining], A[remaining], x[remaining], multiplier[remaining]
    )
    # The eliminated nodes and multipliers follow, the last pair first.
    for first, second, A_first, gap in reversed(pairs):
        second_node = A_first @ x[first] - gap
        second_multiplier = multiplier[first]
        multiplier[first] = H[second] @ second_node + A[second].mT @ second_multiplier - x[second]
        x[second], multiplier[second] = second_node, second_multiplier
    x *= size[:, None]
    multiplier /= size[:, None]
    return x, multiplier


def _solved_bands(
    coupled: BoolArray,
    variance: Array,
    hessian: Array,
    transition: Array,
    stationarity: Array,
    continuity: Array,
) -> tuple[Array, Array]:
    """Solve the system of `solve_continuity` as a banded matrix, for states of order one."""
    # SciPy's linear algebra takes half a second to import.
    from scipy.linalg.lapack import dgbsv  # noqa: PLC0415  # pyright: ignore[reportAttributeAccessIssue]

    s, n, r = stationarity.shape
    # Row i of column j is entry (j, 2 width + i - j) of the transposed bands. LAPACK takes matrices
    # by column, and keeps `width` more rows for its factors. The bands of a long record are large:
    # they are filled in place.
    width = 2 * n - 1
    bands = np.zeros((s, 2 * n, 3 * width + 1))
    for column in range(n):
        first = 2 * width - column
        state = bands[:, column, first:]
        multiplier = bands[:, n + column, first - n :]
        state[:, :n] = hessian[:, :, column]
        state[:, n : 2 * n] = transition[:, :, column]
        multiplier[:, :n] = transition[:, column]
        multiplier[:, n + column] = np.where(coupled, -variance[column], 1.0)
    link = -1.0 * coupled[:, None]
    bands[:, n:, 2 * width + n] = link  # of a multiplier, in the row of the next state
    bands[1:, :n, 2 * width - n] = link[:-1]

    right = np.hstack([stationarity, continuity]).reshape(2 * n * s, r)
    matrix = bands.reshape(2 * n * s, -1).T
    # LAPACK works in this memory: `scipy.linalg.solve_banded` would copy the bands twice.
    *_, solution, failure = dgbsv(width, width, matrix, right, overwrite_ab=1, overwrite_b=1)
    if failure or not all_finite(solution):
        raise np.linalg.LinAlgError("the nodes of the record are not determined.")
    solution = solution.reshape(s, 2 * n, r)
    return solution[:, :n], solution[:, n:]


@np.errstate(all="ignore")
def state_sizes(hessian: Array, transition: Array) -> Array:
    """Return the change (n,) of each state that changes the outputs by one, at once or later.

    If only the outputs within a segment counted, the sizes in a chain of 40 masses would spread
    over 26 decades, and no digit of its nodes would be right. A state that changes no output has
    size 1.

    Parameters
    ----------
    hessian, transition : (s, n, n) arrays
        As in `solve_continuity`.
    """
    curvature = np.abs(np.linalg.diagonal(hessian)).mean(axis=0)
    passed_on = (transition**2).mean(axis=0).T
    for _ in range(len(curvature)):
        later = passed_on @ curvature
        # An unstable state counts no more than what the outputs show at once.
        share = min(curvature.max() / max(later.max(), 1e-300), 1.0)
        curvature = np.maximum(curvature, share * later)
    # Square roots and products of these stay within double range; what has overflowed counts as 1.
    usable = (curvature > 1e-200) & (curvature < 1e200)
    return 1 / np.sqrt(np.where(usable, curvature, 1.0))
