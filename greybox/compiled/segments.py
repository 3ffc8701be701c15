"""All segments of a record, evaluated at once: simulated from their nodes, and linearized along the simulation.

The data are cut into segments of equal length; the state at the beginning of each, its node, is an unknown, and
continuity from one to the next a constraint (Bock 1983, Recent advances in parameter identification techniques for
ODE). One step of the model is evaluated for all segments in one call, sample by sample.

Columns run over segments, sample by sample: column i · s + j is sample i of segment j.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.code_generation import CompiledLinearization
from greybox.compiled.sample_step import SampleStep
from greybox.compiled.sampled_data import SampledData
from greybox.compiled.vectorized import Columns

Array = NDArray[np.float64]

# Samples whose derivatives are in memory at once: 20 000 with five states and ten parameters take 25 MB, and a longer
# batch is no faster.
BATCH = 20_000

# Samples that make the mean transition of a record, evenly over it: its poles then move by less than the limits that
# they are held against.
MEAN_SAMPLES = 500


@dataclass(frozen=True, eq=False)
class Linearization:
    """Linearization of one record at its s nodes (n,) and q active parameters, of weighted residuals e.

    Attributes
    ----------
    end, transition, parameter_sensitivity : (s, n), (s, n, n) and (s, n, q) arrays
        Ends of the segments and their derivatives by node and parameters.
    node_hessian, cross_hessian, node_gradient : (s, n, n), (s, n, q) and (s, n) arrays
        JᵀJ of the node with itself and with the parameters, and Jᵀe, of every segment.
    parameter_hessian, parameter_gradient : (q, q) and (q,) arrays
        JᵀJ and Jᵀe of the parameters, of all segments together.
    moments : (s, k, k, n) and (k, k, q) arrays, or None
        Sums over samples of e_a · de_b by every node and by the parameters, where they were asked for.
    """

    end: Array
    transition: Array
    parameter_sensitivity: Array
    node_hessian: Array
    cross_hessian: Array
    node_gradient: Array
    parameter_hessian: Array
    parameter_gradient: Array
    moments: tuple[Array, Array] | None = None


class Segments:
    """The segments of one record, for the parameters that `active` names (those that are estimated)."""

    def __init__(
        self, step: SampleStep, data: SampledData, active: NDArray[np.integer], compile_linearization: bool = False
    ) -> None:
        """Prepare the functions of `step`; `compile_linearization` translates the linearization to C."""
        self._step = step
        self._data = data
        self.active = active
        self.n = step.function.size1_in(0)
        self.k = step.function.size1_out(1)
        self.length = data.segment_length
        self._measured = _by_sample(_measured_rows(data), data)
        self.counts = (self._measured[self.k : 2 * self.k] != 0).sum(axis=1)
        self._placed: tuple[tuple[float, ...], Array] | None = None
        self._ordered: tuple[Array, Array] | None = None
        self._compiled = None
        if compile_linearization:
            self._compiled = CompiledLinearization(step.function, active.tolist(), data.segments, data.segment_length)

    # --- compiled functions, built when they are first asked for -----------------------------------------------------

    @cached_property
    def _advance(self) -> Columns:
        """The next state, from x, q and data."""
        x, q, d = self._step.symbols()
        return self._columns("advance", [x, q, d], [self._step.function(x, q, d)[0]])

    @cached_property
    def _output(self) -> Columns:
        """Residual and output, from x, q and data."""
        x, q, d = self._step.symbols()
        return self._columns("output", [x, q, d], list(self._step.function(x, q, d)[1:]))

    @cached_property
    def _derivatives(self) -> Columns:
        """Derivatives of the next state and of the residual by x and active parameters, and the residual."""
        x, q, d = self._step.symbols()
        after, e, _ = self._step.function(x, q, d)
        by_state = [ca.jacobian(after, x), ca.jacobian(e, x)]
        active = self.active.tolist()
        by_parameters = [ca.jacobian(after, q)[:, active], ca.jacobian(e, q)[:, active]]
        slopes = [ca.densify(ca.horzcat(a, b)) for a, b in zip(by_state, by_parameters, strict=True)]
        return self._columns("derivatives", [x, q, d], [*slopes, e])

    @cached_property
    def _by_state(self) -> Columns:
        """Derivatives of the next state and of the residual by x."""
        x, q, d = self._step.symbols()
        after, e, _ = self._step.function(x, q, d)
        return self._columns("by_state", [x, q, d], [ca.densify(ca.jacobian(after, x)), ca.densify(ca.jacobian(e, x))])

    def _columns(self, name: str, arguments: list[Any], results: list[Any]) -> Columns:
        return Columns(ca.Function(name, arguments, results, {"cse": True}), shared=(1,))

    # --- data ---------------------------------------------------------------------------------------------------------

    def data(self, delays: Array) -> Array:
        """Return the data of all samples, (width, columns), inputs placed for these delays (m,).

        The same array as the last time, as long as no delay has passed a whole sample.
        """
        steps = [stretch.step for stretch in self._data.stretches]
        whole = tuple(np.floor(np.asarray(delays)[:, None] / steps + 1e-9).ravel())
        if self._placed is None or self._placed[0] != whole:
            inputs = np.vstack(self._data.delayed_inputs(delays))
            self._placed = (whole, np.vstack([_by_sample(inputs, self._data), self._measured]))
        return self._placed[1]

    def rows(self, data: Array) -> Array:
        """Return the data of all samples in their order, (samples, width)."""
        if self._ordered is None or self._ordered[0] is not data:
            self._ordered = (data, np.ascontiguousarray(self.in_order(data).T))
        return self._ordered[1]

    def columns(self, values: Array) -> Array:
        """Return values (r, samples) in the order of the samples as columns."""
        return _by_sample(values, self._data)

    def in_order(self, values: Array) -> Array:
        """Return columns (r, columns) in the order of the samples."""
        s = self._data.segments
        return values.reshape(len(values), self.length, s).transpose(0, 2, 1).reshape(len(values), s * self.length)

    # --- simulation ---------------------------------------------------------------------------------------------------

    def simulate(self, nodes: Array, q: Array, data: Array) -> tuple[Array, Array]:
        """Return the states at all samples (n, columns), and at the ends of the segments (s, n)."""
        s = len(nodes)
        x = nodes.T
        states = np.empty((self.n, self.length * s))
        for i in range(self.length if self.n else 0):
            sample = slice(i * s, (i + 1) * s)
            states[:, sample] = x
            (x,) = self._advance(x, q, data[:, sample])
        return states, x.T

    def simulate_stretches(self, nodes: Array, q: Array, data: Array) -> tuple[Array, Array, Array, Array]:
        """Simulate every stretch from its first node (of (s, n)) to its end, without a segment's beginning in between.

        Returns nodes (s, n), states at all samples (n, columns), ends (s, n), and the sums of the products of the
        residuals of two outputs (k, k).
        """
        rows = self.rows(data)
        states = np.empty((len(rows), self.n))
        ends = np.empty_like(nodes)
        products = np.zeros((self.k, self.k))
        first = 0
        for count in self._data.segment_counts:
            samples = slice(first * self.length, (first + count) * self.length)
            run, residuals = self._step.simulate(nodes[first], q, rows[samples])
            states[samples] = run[:-1]
            ends[first : first + count] = run[self.length :: self.length]
            products += residuals.T @ residuals
            first += count
        return states[:: self.length].copy(), self.columns(states.T), ends, products

    def residuals(self, states: Array, q: Array, data: Array) -> Array:
        """Return measured less simulated outputs (k, columns), zero where nothing was measured."""
        return self._output(states, q, data)[0]

    def outputs(self, states: Array, q: Array, data: Array) -> Array:
        """Return simulated outputs (k, columns)."""
        return self._output(states, q, data)[1]

    # --- linearization ------------------------------------------------------------------------------------------------

    def linearize(
        self, states: Array, end: Array, q: Array, weight: Array, data: Array, *, moments: bool = False
    ) -> Linearization:
        """Linearize along the states, the residuals multiplied by `weight`, a square root of the inverse covariance."""
        if self._compiled is not None and not moments:
            found = self._linearize_in_c(states, q, weight, data)
            if found is not None:
                return found
        s, n = len(end), self.n
        v = n + len(self.active)
        transition = np.empty((s, n, v))
        node_hessian = np.empty((s, n, n))
        cross_hessian = np.empty((s, n, v - n))
        node_gradient = np.empty((s, n))
        parameter_hessian = np.zeros((v - n, v - n))
        parameter_gradient = np.zeros(v - n)
        k = self.k if moments else 0
        node_moments = np.empty((s, k, k, n))
        parameter_moments = np.zeros((k, k, v - n))

        for batch in self.batches(s):
            transition[batch], J, e = self.sensitivities(states, q, data, batch)
            J = weight @ J
            e = weight @ e[..., None]
            if moments:
                M = (e[..., 0].transpose(0, 2, 1) @ J.reshape(*J.shape[:2], k * v)).reshape(-1, k, k, v)
                node_moments[batch] = M[..., :n]
                parameter_moments += M[..., n:].sum(axis=0)
            J = J.reshape(len(J), -1, v)
            e = e.reshape(len(e), -1)
            H = J.transpose(0, 2, 1) @ J
            g = (e[:, None, :] @ J)[:, 0]
            node_hessian[batch] = H[:, :n, :n]
            cross_hessian[batch] = H[:, :n, n:]
            node_gradient[batch] = g[:, :n]
            parameter_hessian += H[:, n:, n:].sum(axis=0)
            parameter_gradient += g[:, n:].sum(axis=0)

        return Linearization(
            end=end,
            transition=transition[:, :, :n],
            parameter_sensitivity=transition[:, :, n:],
            node_hessian=node_hessian,
            cross_hessian=cross_hessian,
            node_gradient=node_gradient,
            parameter_hessian=parameter_hessian,
            parameter_gradient=parameter_gradient,
            moments=(node_moments, parameter_moments) if moments else None,
        )

    def _linearize_in_c(self, states: Array, q: Array, weight: Array, data: Array) -> Linearization | None:
        """Return the linearization by the compiled function, None where a derivative is not finite."""
        assert self._compiled is not None
        n, s = self.n, self._data.segments
        v = n + len(self.active)
        nodes = states[:, :s].T
        end, slopes, products, gradient = self._compiled(nodes, q, weight, self.rows(data))
        if not (math.isfinite(slopes.sum()) and math.isfinite(products.sum())):
            return None

        transition = slopes.reshape(s, v, n).transpose(0, 2, 1)
        place = np.zeros((v, v), dtype=int)
        place[np.triu_indices(v)] = np.arange(v * (v + 1) // 2)
        place = np.maximum(place, place.T)
        return Linearization(
            end=end,
            transition=transition[:, :, :n],
            parameter_sensitivity=transition[:, :, n:],
            node_hessian=products[:, place[:n, :n]],
            cross_hessian=products[:, place[:n, n:]],
            node_gradient=gradient[:, :n],
            parameter_hessian=products.sum(axis=0)[place[n:, n:]],
            parameter_gradient=gradient[:, n:].sum(axis=0),
        )

    def sensitivities(self, states: Array, q: Array, data: Array, batch: slice) -> tuple[Array, Array, Array]:
        """Return derivatives of the ends (c, n, v) and residuals (c, length, k, v), and the residuals (c, length, k).

        Of the c segments of a `batch`, by node and active parameters.
        """
        n, k, length = self.n, self.k, self.length
        v = n + len(self.active)
        s = data.shape[1] // length
        count = len(range(s)[batch])

        def chosen(values: Array) -> Array:
            return values.reshape(len(values), length, s)[:, :, batch].reshape(len(values), length * count)

        A, C, e = _finite(self._derivatives(chosen(states), q, chosen(data)))
        # CasADi stacks matrices column by column.
        A = np.ascontiguousarray(A.reshape(v, n, length, count).transpose(2, 3, 1, 0))
        C = np.ascontiguousarray(C.reshape(v, k, length, count).transpose(3, 2, 1, 0))
        S = np.tile(np.eye(n, v), (count, 1, 1))
        J = np.empty((count, length, k, v))
        for i in range(length):
            np.matmul(C[:, i, :, :n], S, out=J[:, i])
            S = A[i, :, :, :n] @ S
            S[:, :, n:] += A[i, :, :, n:]
        J[..., n:] += C[..., n:]
        return S, J, e.reshape(k, length, count).transpose(2, 1, 0)

    def mean_transition(self, states: Array, q: Array, data: Array) -> tuple[Array, Array]:
        """Return the mean derivatives of the next state (n, n) and of the outputs (k, n) by the state."""
        sample = slice(None, None, max(states.shape[1] // MEAN_SAMPLES, 1))
        A, E = _finite(self._by_state(states[:, sample], q, data[:, sample]))
        A = A.reshape(self.n, self.n, -1)
        E = E.reshape(self.n, self.k, -1)
        return A.mean(axis=2).T, -E.mean(axis=2).T

    def batches(self, s: int) -> list[slice]:
        """Return slices of s segments whose derivatives fit into memory together."""
        size = max(BATCH // self.length, 1)
        return [slice(first, min(first + size, s)) for first in range(0, s, size)]


def _finite(values: list[Array]) -> list[Array]:
    """Return derivatives with zeros for what is not finite: that of a guarded root, sqrt(max(h, 0)), is 0 · inf."""
    return [v if math.isfinite(v.sum()) else np.nan_to_num(v, nan=0.0, posinf=0.0, neginf=0.0) for v in values]


def _measured_rows(data: SampledData) -> Array:
    """Return measured outputs, zero where missing; one where they are there; and the step of every sample."""
    measured = data.measured
    return np.vstack([np.nan_to_num(measured), np.isfinite(measured), data.steps])


def _by_sample(values: Array, data: SampledData) -> Array:
    """Return (r, samples) as columns."""
    ordered = values.reshape(len(values), data.segments, data.segment_length).transpose(0, 2, 1)
    return np.ascontiguousarray(ordered).reshape(len(values), data.samples)
