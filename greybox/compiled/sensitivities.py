"""One record compiled for multiple shooting: a step and its derivatives, evaluated for all segments at once.

The data are cut into segments; the state at the beginning of each is an unknown, and continuity from one to the next a
constraint (Bock 1983, Recent advances in parameter identification techniques for ODE). Here is what one evaluation
gives: paths, ends and residuals, or the blocks of the Gauss-Newton system.

Columns run over segments, sample by sample: column i · s + j is sample i of segment j.
"""

import math
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.code_generation import CompiledBlocks
from greybox.compiled.sample_step import SampleStep
from greybox.compiled.sampled_data import Experiment
from greybox.compiled.vectorized import Columns

Array = NDArray[np.float64]
COLUMNS = 20000  # samples whose derivatives are in memory at once
SOME = 500  # samples whose derivatives make a mean


@dataclass(frozen=True, eq=False)
class Blocks:
    """Linearization of one record at its node states (s, n) and q active parameters, of weighted residuals e.

    Attributes
    ----------
    end, to_state, to_parameters : (s, n), (s, n, n) and (s, n, q) arrays
        Ends of the segments and their derivatives.
    corner, mixed, gradient : (s, n, n), (s, n, q) and (s, n) arrays
        JᵀJ of the node with itself and with the parameters, and Jᵀe, of every segment.
    own, slope : (q, q) and (q,) arrays
        JᵀJ and Jᵀe of the parameters, of all segments together.
    moments : (s, k, k, n) and (k, k, q) arrays, or None
        Sums over samples of e_a · de_b by every node and by the parameters, where they were asked for.
    """

    end: Array
    to_state: Array
    to_parameters: Array
    corner: Array
    mixed: Array
    gradient: Array
    own: Array
    slope: Array
    moments: tuple[Array, Array] | None = None


class Shooting:
    """The functions of one record, for the parameters that `active` names (those that are estimated)."""

    def __init__(
        self, step: SampleStep, experiment: Experiment, active: NDArray[np.integer], compile_blocks: bool = False
    ) -> None:
        self.experiment, self.active = experiment, active
        self.n, self.size = step.function.size1_in(0), step.function.size1_in(1)
        self.k = step.function.size1_out(1)
        self._read_experiment()
        self._step = step
        self._compiled = None
        if compile_blocks:
            self._compiled = CompiledBlocks(step.function, active.tolist(), experiment.segments, experiment.segment)

    @cached_property
    def _advance(self) -> Columns:
        """The next state, from x, q and data."""
        x, q, d = _arguments(self._step)
        return _columns("advance", [x, q, d], [self._step.function(x, q, d)[0]])

    @cached_property
    def _output(self) -> Columns:
        """Residual and output, from x, q and data."""
        x, q, d = _arguments(self._step)
        return _columns("output", [x, q, d], list(self._step.function(x, q, d)[1:]))

    @cached_property
    def _derivatives(self) -> Columns:
        """Derivatives of the next state and of the residual by x and active parameters, and the residual."""
        x, q, d = _arguments(self._step)
        after, e, _ = self._step.function(x, q, d)
        free = ca.vertcat(x, q[self.active.tolist()])
        slopes = [ca.densify(ca.jacobian(after, free)), ca.densify(ca.jacobian(e, free)), e]
        return _columns("derivatives", [x, q, d], slopes)

    @cached_property
    def _by_state(self) -> Columns:
        """Derivatives of the next state and of the residual by x."""
        x, q, d = _arguments(self._step)
        after, e, _ = self._step.function(x, q, d)
        return _columns("by_state", [x, q, d], [ca.densify(ca.jacobian(after, x)), ca.densify(ca.jacobian(e, x))])

    def on(self, experiment: Experiment) -> "Shooting":
        """Return the same functions on another cut of the record."""
        result = copy(self)
        result.experiment, result._compiled = experiment, None
        result._read_experiment()
        return result

    def _read_experiment(self) -> None:
        self._fixed = _by_sample(_present(self.experiment), self.experiment)
        self.counts = (self._fixed[self.k : 2 * self.k] != 0).sum(axis=1)
        self._data: Array | None = None
        self._whole: Any = None
        self._in_order: tuple[Array, Array] | None = None

    @property
    def length(self) -> int:
        """Samples a segment."""
        return self.experiment.segment

    def data(self, delays: Array) -> Array:
        """Return the data of all samples, (width, columns), windows placed for these delays (m,)."""
        key = tuple(np.floor(np.asarray(delays)[:, None] / [s.step for s in self.experiment.stretches] + 1e-9).ravel())
        if self._data is None or key != self._whole:
            around = np.vstack(self.experiment.windows(delays))
            self._data = np.vstack([_by_sample(around, self.experiment), self._fixed])
            self._whole = key
        return self._data

    def paths(self, nodes: Array, q: Array, data: Array) -> tuple[Array, Array]:
        """Return the states at all samples (n, columns), and at the ends of the segments (s, n)."""
        s = len(nodes)
        x, states = nodes.T, np.empty((self.n, self.length * s))
        for i in range(self.length if self.n else 0):
            some = slice(i * s, (i + 1) * s)
            states[:, some] = x
            (x,) = self._advance(x, q, data[:, some])
        return states, x.T

    def residuals(self, states: Array, q: Array, data: Array) -> Array:
        """Return measured less simulated outputs (k, columns), zero where nothing was measured."""
        return self._output(states, q, data)[0]

    def outputs(self, states: Array, q: Array, data: Array) -> Array:
        """Return simulated outputs (k, columns)."""
        return self._output(states, q, data)[1]

    def blocks(self, states: Array, end: Array, q: Array, weight: Array, data: Array, moments: bool = False) -> Blocks:
        """Linearize along the states, the residuals multiplied by `weight`, a square root of the inverse covariance."""
        if (
            self._compiled is not None
            and not moments
            and (found := self._blocks_in_c(states, q, weight, data)) is not None
        ):
            return found
        s, v, n = len(end), self.n + len(self.active), self.n
        corner, mixed, gradient = np.empty((s, n, n)), np.empty((s, n, v - n)), np.empty((s, n))
        transition, own, slope = np.empty((s, n, v)), np.zeros((v - n, v - n)), np.zeros(v - n)
        k = self.k if moments else 0
        of_nodes, of_parameters = np.empty((s, k, k, n)), np.zeros((k, k, v - n))
        for some in self.chunks(s):
            part, J, e = self.sensitivities(states, q, data, some)
            transition[some] = part
            J, e = weight @ J, weight @ e[..., None]
            if moments:
                M = (e[..., 0].transpose(0, 2, 1) @ J.reshape(*J.shape[:2], k * v)).reshape(-1, k, k, v)
                of_nodes[some], of_parameters = M[..., :n], of_parameters + M[..., n:].sum(axis=0)
            J, e = J.reshape(len(J), -1, v), e.reshape(len(e), -1)
            H, g = J.transpose(0, 2, 1) @ J, (e[:, None, :] @ J)[:, 0]
            corner[some], mixed[some], gradient[some] = H[:, :n, :n], H[:, :n, n:], g[:, :n]
            own, slope = own + H[:, n:, n:].sum(axis=0), slope + g[:, n:].sum(axis=0)
        both = (of_nodes, of_parameters) if moments else None
        return Blocks(end, transition[:, :, :n], transition[:, :, n:], corner, mixed, gradient, own, slope, both)

    def _blocks_in_c(self, states: Array, q: Array, weight: Array, data: Array) -> Blocks | None:
        """Return the blocks by the compiled linearization, None where a derivative is not finite."""
        assert self._compiled is not None
        n, v, s = self.n, self.n + len(self.active), self.experiment.segments
        nodes = states[:, :s].T
        end, slopes, products, gradient = self._compiled(nodes, q, weight, self.rows(data))
        if not (math.isfinite(slopes.sum()) and math.isfinite(products.sum())):
            return None
        transition = slopes.reshape(s, v, n).transpose(0, 2, 1)
        place = np.zeros((v, v), dtype=int)
        place[np.triu_indices(v)] = np.arange(v * (v + 1) // 2)
        place = np.maximum(place, place.T)
        own = products.sum(axis=0)[place[n:, n:]]
        return Blocks(
            end=end,
            to_state=transition[:, :, :n],
            to_parameters=transition[:, :, n:],
            corner=products[:, place[:n, :n]],
            mixed=products[:, place[:n, n:]],
            gradient=gradient[:, :n],
            own=own,
            slope=gradient[:, n:].sum(axis=0),
        )

    def sensitivities(self, states: Array, q: Array, data: Array, some: slice) -> tuple[Array, Array, Array]:
        """Return derivatives of the ends (c, n, v) and residuals (c, length, k, v), and the residuals (c, length, k).

        Of the c segments `some`, by node and active parameters.
        """
        n, v, k, length = self.n, self.n + len(self.active), self.k, self.length
        s = states.shape[1] // length if n else data.shape[1] // length
        count = len(range(s)[some])

        def chosen(values: Array) -> Array:
            return values.reshape(len(values), length, s)[:, :, some].reshape(len(values), length * count)

        A, C, e = _finite(self._derivatives(chosen(states), q, chosen(data)))
        # CasADi stacks matrices column by column.
        A = np.ascontiguousarray(A.reshape(v, n, length, count).transpose(2, 3, 1, 0))
        C = np.ascontiguousarray(C.reshape(v, k, length, count).transpose(3, 2, 1, 0))
        S, J = np.tile(np.eye(n, v), (count, 1, 1)), np.empty((count, length, k, v))
        for i in range(length):
            np.matmul(C[:, i, :, :n], S, out=J[:, i])
            S = A[i, :, :, :n] @ S
            S[:, :, n:] += A[i, :, :, n:]
        J[..., n:] += C[..., n:]
        return S, J, e.reshape(k, length, count).transpose(2, 1, 0)

    def mean_derivatives(self, states: Array, q: Array, data: Array) -> tuple[Array, Array]:
        """Return the derivatives of the next state (n, n) and of the outputs (k, n) by the state, the mean of some."""
        some = slice(None, None, max(states.shape[1] // SOME, 1))
        A, E = _finite(self._by_state(states[:, some], q, data[:, some]))
        return A.reshape(self.n, self.n, -1).mean(axis=2).T, -E.reshape(self.n, self.k, -1).mean(axis=2).T

    def rows(self, data: Array) -> Array:
        """Return the data of all samples in their order, (samples, width)."""
        if self._in_order is None or self._in_order[0] is not data:
            self._in_order = (data, np.ascontiguousarray(self.in_order(data).T))
        return self._in_order[1]

    def columns(self, values: Array) -> Array:
        """Return values (r, samples) in the order of the samples as columns."""
        return _by_sample(values, self.experiment)

    def in_order(self, values: Array) -> Array:
        """Return columns (r, columns) in the order of the samples."""
        s = self.experiment.segments
        return values.reshape(len(values), self.length, s).transpose(0, 2, 1).reshape(len(values), s * self.length)

    def chunks(self, s: int) -> list[slice]:
        """Return slices of s segments whose derivatives fit into memory together."""
        size = max(COLUMNS // self.length, 1)
        return [slice(at, min(at + size, s)) for at in range(0, s, size)]


def _finite(found: list[Array]) -> list[Array]:
    """Return derivatives with zeros for what is not finite: that of a guarded root, sqrt(max(h, 0)), is 0 · inf."""
    return [v if math.isfinite(v.sum()) else np.nan_to_num(v, nan=0.0, posinf=0.0, neginf=0.0) for v in found]


def _arguments(step: SampleStep) -> list[ca.SX]:
    return [ca.SX.sym(name, step.function.numel_in(k)) for k, name in enumerate("xqd")]


def _columns(name: str, arguments: list[ca.SX], results: list[ca.SX]) -> Columns:
    return Columns(ca.Function(name, arguments, results, {"cse": True}), shared=(1,))


def _present(experiment: Experiment) -> Array:
    measured = experiment.measured
    return np.vstack([np.nan_to_num(measured), np.isfinite(measured), experiment.steps])


def _by_sample(values: Array, experiment: Experiment) -> Array:
    """Return (r, samples) as columns."""
    s, length = experiment.segments, experiment.segment
    ordered = values.reshape(len(values), s, length).transpose(0, 2, 1)
    return np.ascontiguousarray(ordered).reshape(len(values), s * length)
