"""Condensing: nodes and multipliers of continuity are eliminated from the Gauss-Newton system of records.

The Karush-Kuhn-Tucker system of a chain of segments is banded: each segment is coupled to the next
by its end state alone. Solved for several right-hand sides at once (the residuals, and one for each
parameter), it gives how nodes and multipliers follow the parameters, so that a small system in the
parameters is left.

Source: Bock and Plitt (1984), A multiple shooting algorithm for direct solution of optimal control
problems, IFAC Proceedings 17(2); Betts (2010), Practical Methods for Optimal Control and
Estimation, 2nd ed., chapter 4.
"""

import threading
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.part import Condensed, Trajectory
from greybox.compiled.sampled_data import SampledData
from greybox.compiled.segments import Linearization, Segments
from greybox.files.arrays import Array, BoolArray
from greybox.modeling.one_thread import one_thread_at_a_time

# Segments from which a chain is long: of fewer, a solver takes less than 50 MB.
LONG_CHAIN = 10_000


def condense(
    b: Linearization,
    trajectory: Trajectory,
    variance: Array,
    damping: float,
    data: SampledData,
    segments: Segments,
) -> Condensed:
    """Return the quadratic model in the solver's variables, with the nodes of all records eliminated.

    Continuity is exact where its `variance` (n,) is zero. `damping` holds the free nodes, relative to
    their curvature (Levenberg-Marquardt).
    """
    node_damping = np.zeros_like(trajectory.gaps)
    damped = b
    if damping:
        node_damping = damping * _node_curvature(b, variance, data)
        added = node_damping[:, :, None] * np.eye(segments.n)
        damped = replace(b, node_hessian=b.node_hessian + added)

    # The right-hand sides: what the residuals ask for, and how that follows the parameters.
    stationarity = -np.concatenate([b.node_gradient[:, :, None], b.cross_hessian], axis=2)
    continuity = -np.concatenate([trajectory.gaps[:, :, None], b.parameter_sensitivity], axis=2)
    x, multiplier = solve_in_outputs(damped, data.coupled, stationarity, continuity, variance)

    linked = np.where(data.coupled[:, None, None], b.parameter_sensitivity, 0.0)
    hessian, gradient = b.parameter_hessian.copy(), b.parameter_gradient.copy()
    for record, rows in enumerate(segments.record_rows):
        change = np.tensordot(b.cross_hessian[rows], x[rows], ((0, 1), (0, 1)))
        change += np.tensordot(linked[rows], multiplier[rows], ((0, 1), (0, 1)))
        hessian[record] += change[:, 1:]
        gradient[record] += change[:, 0]

    hessian = (hessian + hessian.transpose(0, 2, 1)) / 2
    slope = trajectory.detail.slope
    slopes = np.broadcast_to(slope, (segments.number, *slope.shape[-2:]))
    by_z = slopes.reshape(-1, slope.shape[-1])
    return Condensed(
        hessian=by_z.T @ (hessian @ slopes).reshape(by_z.shape),
        gradient=by_z.T @ gradient.ravel(),
        node_step=x[:, :, 0],
        node_sensitivity=_by_variables(x[:, :, 1:], slopes, segments),
        multiplier=multiplier[:, :, 0],
        multiplier_sensitivity=_by_variables(multiplier[:, :, 1:], slopes, segments),
        damping=node_damping,
        decrease=_predicted_decrease(b, x[:, :, 0], multiplier[:, :, 0], trajectory.gaps, variance),
    )


def close_gaps(b: Linearization, trajectory: Trajectory, coupled: BoolArray) -> Array:
    """Return the nodes (s, n) that close the gaps with the least change of the outputs."""
    columns = 1 + b.cross_hessian.shape[2]  # as in `condense`, whose solver is then used again
    stationarity = np.zeros((*trajectory.gaps.shape, columns))
    continuity = np.zeros_like(stationarity)
    continuity[:, :, 0] = -trajectory.gaps
    exact = np.zeros(trajectory.gaps.shape[1])
    x, _ = solve_in_outputs(b, coupled, stationarity, continuity, exact)
    return trajectory.nodes + x[:, :, 0]


def solve_in_outputs(
    b: Linearization,
    coupled: BoolArray,
    stationarity: Array,
    continuity: Array,
    variance: Array,
) -> tuple[Array, Array]:
    """Solve for nodes and multipliers in units in which the curvature is one, so that both are of one size."""
    curvature = np.mean(b.node_hessian.diagonal(axis1=1, axis2=2), axis=0)
    # Smaller curvatures are what rounding makes of zero.
    visible = curvature > 1e-30 * curvature.max(initial=0.0) + 1e-300
    unit = 1 / np.sqrt(np.where(visible, curvature, 1.0))
    column = unit[:, None]
    x, multiplier = solve_continuity(
        # The ridge holds states that no output shows.
        b.node_hessian * unit * column + 1e-10 * np.eye(len(unit)),
        b.transition * unit / column,
        coupled,
        stationarity * column,
        continuity / column,
        variance / unit**2,
    )
    return x * column, multiplier / column


def _by_variables(by_active: Array, slopes: Array, segments: Segments) -> Array:
    """Return derivatives by z, for those by the active parameters of every record."""
    pairs = zip(segments.record_rows, slopes, strict=True)
    return np.concatenate([by_active[rows] @ slope for rows, slope in pairs])


def _predicted_decrease(
    b: Linearization, step: Array, multiplier: Array, gaps: Array, variance: Array
) -> float:
    """Return the decrease of the merit that the quadratic model predicts for the step of the nodes alone."""
    curved = float((step * (b.node_hessian @ step[:, :, None])[:, :, 0]).sum())
    change = float((b.node_gradient * step).sum()) + 0.5 * curved
    if np.all(variance > 0):
        gaps_after = variance * multiplier
        change += 0.5 * float(((gaps_after**2 - gaps**2) / variance).sum())
    return max(-change, 0.0)


def _node_curvature(b: Linearization, variance: Array, data: SampledData) -> Array:
    """Return the second derivatives of outputs and continuity penalty by every free node state, (s, n).

    Where continuity is exact the first nodes of every stretch are free.
    """
    curvature = b.node_hessian.diagonal(axis1=1, axis2=2)
    if not np.all(variance > 0):
        return np.where(data.begins_stretch[:, None], curvature, 0.0)
    coupled = data.coupled[:, None]
    penalty = np.where(coupled, (b.transition**2 / variance[:, None]).sum(axis=1), 0.0)
    penalty[1:] += np.where(coupled[:-1], 1 / variance, 0.0)
    return curvature + penalty


def solve_continuity(
    hessian: Array,
    transition: Array,
    coupled: BoolArray,
    stationarity: Array,
    continuity: Array,
    variance: Array,
) -> tuple[Array, Array]:
    """Solve the Karush-Kuhn-Tucker system of a chain of s segments with n states for r right-hand sides.

    H_j x_j + A_jᵀ λ_j - λ_(j-1) = stationarity_j and A_j x_j - x_(j+1) - P λ_j = continuity_j, with
    λ_j = 0 where segment j is not `coupled` to the next. P = diag(variance) is zero for exact
    continuity; otherwise continuity is a penalty gap²/2P. Sparse QR in the order x_0, λ_0, x_1, λ_1
    ... takes a time linear in s.

    Parameters
    ----------
    hessian, transition : (s, n, n) arrays
        H and A.
    coupled : (s,) bool array
    stationarity, continuity : (s, n, r) arrays
    variance : (n,) array

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
    size = _state_sizes(hessian, transition)
    linked = coupled[:, None, None]
    transition = np.where(linked, transition * size / size[:, None], 0.0)
    hessian = hessian * size * size[:, None]

    link = np.where(coupled, -1.0, 0.0)
    # Column by column: of x_k the row of the previous λ, H and A; of λ_k the rows of A, itself, and
    # the next x.
    states = np.zeros((s, n, 2 * n + 1))
    states[1:, :, 0] = link[:-1, None]
    states[:, :, 1 : n + 1] = hessian.transpose(0, 2, 1)
    states[:, :, n + 1 :] = transition.transpose(0, 2, 1)
    multipliers = np.zeros((s, n, n + 2))
    multipliers[:, :, :n] = transition
    multipliers[:, :, n] = np.where(coupled[:, None], -variance / size**2, 1.0)
    multipliers[:, :, n + 1] = link[:, None]
    values = np.concatenate([states.reshape(s, -1), multipliers.reshape(s, -1)], axis=1).ravel()

    gaps = np.where(linked, continuity / size[:, None], 0.0)
    right = np.concatenate([stationarity * size[:, None], gaps], axis=1).reshape(2 * n * s, r)
    solver = _solvers.of(s, n, r)
    solution = solver(values[solver.inside], np.ascontiguousarray(right.T)).T
    if not np.all(np.isfinite(solution)):
        raise np.linalg.LinAlgError(
            "the nodes of the record are not determined: its KKT system is singular."
        )
    solution = np.ascontiguousarray(solution).reshape(s, 2 * n, r)
    return solution[:, :n] * size[:, None], solution[:, n:] / size[:, None]


def _state_sizes(hessian: Array, transition: Array) -> Array:
    """Return the change (n,) of each state that changes the outputs by one, at once or later; 1 if none does."""
    curvature = np.abs(hessian.diagonal(axis1=1, axis2=2)).mean(axis=0)
    passed_on = (transition**2).mean(axis=0).T
    for _ in range(len(curvature)):
        curvature = np.where(curvature > 0, curvature, passed_on @ curvature)
    # Square roots and products of these stay within double range.
    usable = (curvature > 1e-200) & (curvature < 1e200)
    return 1 / np.sqrt(np.where(usable, curvature, 1.0))


class _Solver:
    """Sparse QR for one pattern; `inside` are the entries of the uniform blocks that lie in the matrix."""

    @one_thread_at_a_time
    def __init__(self, s: int, n: int, r: int) -> None:
        """Analyze the pattern of s blocks of n states, for r right-hand sides."""
        size = 2 * n * s
        full, unit, nothing = ca.DM.ones(n, n), ca.DM.eye(n), ca.DM(n, n)
        own = ca.blockcat([[full, full], [full, unit]]).sparsity()
        to_next = ca.blockcat([[nothing, nothing], [unit, nothing]]).sparsity()
        sparsity = ca.kron(ca.Sparsity.diag(s), own)
        if s > 1:
            sparsity += ca.kron(ca.Sparsity.band(s, -1), to_next) + ca.kron(
                ca.Sparsity.band(s, 1), to_next.T
            )
        self.inside = np.ones((s, n * (2 * n + 1) + n * (n + 2)), dtype=bool)
        self.inside[0, : n * (2 * n + 1) : 2 * n + 1] = False
        self.inside[-1, n * (2 * n + 1) + n + 1 :: n + 2] = False
        self.inside = self.inside.ravel()
        values, right = ca.MX.sym("values", sparsity.nnz()), ca.MX.sym("right", size, r)
        solution = ca.solve(ca.MX(sparsity, values), right, "qr")
        # A buffer hands over memory as it is; converting numpy arrays to CasADi's takes longer than
        # the solution.
        self._function = ca.Function("chain", [values, right], [solution])
        self._buffer: Any
        self._buffer, self._evaluate = self._function.buffer()
        self._shape = (r, size)

    def __call__(self, values: Array, right: Array) -> Array:
        """Return the solution (r, size) for the entries of the matrix and right-hand sides (r, size)."""
        result = np.full(self._shape, np.nan)  # stays where the matrix is singular
        self._buffer.set_arg(0, values.data)
        self._buffer.set_arg(1, right.data)
        self._buffer.set_res(0, result.data)
        self._evaluate()
        return result


class _Solvers(threading.local):
    """The solvers of one thread: two threads must not share a solver's memory."""

    def __init__(self) -> None:
        self.of = lru_cache(maxsize=8)(_Solver)


_solvers = _Solvers()


def forget_long_chain(segments: int) -> None:
    """Free the memory of the solver of a long chain: 0.3 GB for 60 000 segments, the most of a record."""
    if segments > LONG_CHAIN:
        _solvers.of.cache_clear()
