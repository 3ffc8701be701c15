"""All segments of a record at once: simulated from their nodes, and linearized.

The data are cut into segments of equal length; the state at the beginning of each, its node, is an
unknown, and continuity from one to the next a constraint (Bock 1983, Recent advances in parameter
identification techniques for ODE). One step of the model is evaluated for all segments in one call,
sample by sample.

Columns run over segments, sample by sample: column i · s + j is sample i of segment j.

The derivatives of a sample with many operations are computed substep by substep. A function of all
substeps would repeat every operation of the model for every substep and every direction. The
Jacobian of one substep is as sparse as the model, and one function evaluates it for all substeps
and columns. Products with block-diagonal sparse matrices carry the derivatives from one substep to
the next.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, IntArray
from greybox.engine.compiled.sample_step import SampleStep
from greybox.engine.compiled.vectorized import CHUNK, Columns, Remembering
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.symbolic_reading import as_column, dense_jacobian
from greybox.modeling.traced_once import once

# Samples whose derivatives are in memory at once: with three states and five parameters they take
# 2 MB. For one to twenty states, batches of 2500 to 24 000 samples take equally long. A record that
# fits into one batch is evaluated once for its last step, its standard errors and its test.
BATCH = 6_000

# States up to which derivatives are carried through all segments at once, which takes half the time
# of one product for every segment. With six states, both take as long.
FEW_STATES = 4


class Course(NamedTuple):
    """Where functions of segments are evaluated: along a trajectory.

    Attributes
    ----------
    states : (n, columns) array
    q : (p,) array, or (p, s) with parameters of every segment
    data : (width, columns) array
    """

    states: Array
    q: Array
    data: Array


class Linearization(NamedTuple):
    """Linearization of r records: s nodes (n,), q active parameters, weighted residuals e.

    Attributes
    ----------
    transition, parameter_sensitivity : (s, n, n) and (s, n, q) arrays
        Derivatives of the ends of the segments by node and parameters.
    node_hessian, cross_hessian, node_gradient : (s, n, n), (s, n, q) and (s, n) arrays
        JᵀJ of the node with itself and with the parameters, and Jᵀe, of every segment.
    parameter_hessian, parameter_gradient : (r, q, q) and (r, q) arrays
        JᵀJ and Jᵀe of the parameters, of all segments of each of the r records together.
    """

    transition: Array
    parameter_sensitivity: Array
    node_hessian: Array
    cross_hessian: Array
    node_gradient: Array
    parameter_hessian: Array
    parameter_gradient: Array


class Segments:
    """Segments of equal length, each simulated from its own initial state.

    Derivatives are with respect to that state and the parameters that `active` names. Segments of
    several records follow one another; `records` (s,) is the record of each. The parameters `own`
    differ between these records, and q is then (p, s), for every segment, instead of (p,).
    """

    def __init__(
        self,
        step: SampleStep,
        count: int,
        length: int,
        active: IntArray,
        *,
        records: IntArray | None = None,
        own: bool = False,
    ) -> None:
        """Prepare the functions of `step`."""
        self.step = step
        self.count = count
        self.length = length
        self.active = active
        self.records = np.zeros(count, dtype=int) if records is None else records
        self.number = int(self.records[-1]) + 1 if count else 1  # of records
        self._own = own
        self.n = step.function.size1_in(0)
        self.k = step.function.size1_out(1)

    # --- compiled functions

    @one_thread_at_a_time
    def _columns(self, name: str) -> Callable[..., Sequence[Array]]:
        """Return a function of x, q and data, the same for all segments with this step.

        The names are:

        - "advance": the next state;
        - "output": the residual and the simulated output;
        - "derivatives": the derivatives of the next state and the residual with respect to x and
          the active parameters, and the residual;
        - "output_derivatives": the same with the simulated output instead of the residual.
        """
        # Excerpts and refits share the step, and so the functions that take longest to build.
        key = (name, tuple(self.active.tolist()), self._own)
        built = self.step.built
        if key not in built:
            shared = () if self._own else (1,)
            function: Any
            if self.step.repeats and name not in ("advance", "output"):
                # Finer steps call the same functions for shorter substeps.
                step, substep = self.step, self.step.substep
                derivatives = substep_derivatives(
                    step.measurement, substep, id(substep), *key[:2], shared
                )
                function = partial(derivatives, step.substeps)
            else:
                function = Columns(self._of_sample(name), shared=shared)
            # A minimum is polished, judged and tested along one trajectory. Outputs of a long
            # record would stay in memory.
            built[key] = Remembering(function) if name == "derivatives" else function
        return built[key]

    def _of_sample(self, name: str) -> ca.Function:
        """Return the function of a sample with this name."""
        x, q, d = self.step.symbols()
        if name == "output":
            x, q, d = self.step.measurement.sx_in()
            results: Any = self.step.measurement(x, q, d)[3:]
        elif name == "advance":
            results = [self.step.function(x, q, d)[0]]
        else:
            # One vector of all free variables: an integrator repeats its steps for every
            # Jacobian, not for every column.
            places = self.active.tolist()
            free = type(x).sym("free", self.n + len(places))
            values = type(x)(q)
            if places:
                values[places] = free[self.n :]
            of_free = self.step.function.call([free[: self.n], values, d], True, False)
            compared = of_free[1 if name == "derivatives" else 2]
            slopes = dense_jacobian(ca.vertcat(of_free[0], compared), free)
            at_free = ca.Function("at_free", [free, q, d], [slopes, of_free[1]])
            results = at_free(ca.vertcat(x, *(q[i] for i in places)), q, d)
        # There are few common subexpressions, and the search for them would take four times as long
        # as the rest.
        return ca.Function(name, [x, q, d], results)

    def _evaluate(self, name: str, at: Course) -> Sequence[Array]:
        """Evaluate the function of this name for columns of the segments to which q belongs."""
        if self._own:
            at = at._replace(q=np.tile(at.q, at.data.shape[1] // at.q.shape[1]))
        return self._columns(name)(*at)

    @property
    def first_of_record(self) -> IntArray:
        """Return the first segment of every record."""
        return np.flatnonzero(np.diff(self.records, prepend=-1))

    # --- the order of samples

    def columns(self, values: Array) -> Array:
        """Return values (..., samples) in the order of the samples as columns."""
        return values.reshape(-1, self.count, self.length).mT.reshape(values.shape)

    def in_order(self, values: Array) -> Array:
        """Return columns (r, columns) in the order of the samples."""
        return values.reshape(-1, self.length, self.count).mT.reshape(values.shape)

    def by_segment(self, values: Array) -> Array:
        """Return columns (r, columns) as (segments, length, r)."""
        return values.reshape(-1, self.length, self.count).T

    # --- simulation

    def simulate(self, nodes: Array, q: Array, data: Array) -> tuple[Array, Array]:
        """Return the states (n, columns) at all samples, and the ends (s, n), from nodes (s, n)."""
        # A call from Python takes 12 µs for a sample of all segments together. CasADi's own loop
        # takes 0.9 µs for a sample of one segment. Few long segments are therefore simulated one
        # after the other.
        if self.n and self.length > 10 * self.count:
            return self.simulate_stretches([1] * self.count, nodes, q, data)
        s = self.count
        x = nodes.T
        states = np.empty((self.n, self.length * s))
        advance = self._columns("advance")

        for i in range(self.length if self.n else 0):
            sample = slice(i * s, (i + 1) * s)
            states[:, sample] = x
            (x,) = advance(x, q, data[:, sample])

        return states, x.T

    def simulate_stretches(
        self, counts: Sequence[int], nodes: Array, q: Array, data: Array
    ) -> tuple[Array, Array]:
        """Simulate stretches of this many segments each, from the first node of each to its end.

        Returns states at all samples (n, columns) and ends (s, n).
        """
        rows = np.ascontiguousarray(self.in_order(data).T)
        states = np.empty((len(rows), self.n))
        ends = np.empty_like(nodes)
        first = 0
        for count in counts:
            samples = slice(first * self.length, (first + count) * self.length)
            at = q if q.ndim == 1 else q[:, first]
            run = self.step.simulate(nodes[first], at, rows[samples])
            states[samples] = run[:-1]
            ends[first : first + count] = run[self.length :: self.length]
            first += count

        return self.columns(states.T), ends

    def residuals(self, at: Course) -> Array:
        """Return measured less simulated outputs (k, columns), zero where nothing was measured."""
        return self._evaluate("output", at)[0]

    def products(self, residuals: Array) -> Array:
        """Return the residual products (r, k, k) of every record; residuals are (k, columns)."""
        if self.number == 1:
            return (residuals @ residuals.T)[None]
        by_segment = self.by_segment(residuals)
        return self.by_record(by_segment.mT @ by_segment)

    def by_record(self, values: Array, batch: slice = slice(None)) -> Array:
        """Return the sums (r, ...) by record of the values (c, ...) of a batch of segments."""
        result = np.zeros((self.number, *values.shape[1:]))
        records = self.records[batch]
        # A batch may begin or end within a record, or lack some records.
        starts = np.flatnonzero(np.diff(records, prepend=-1))
        result[records[starts]] = np.add.reduceat(values, starts, axis=0)
        return result

    def outputs(self, at: Course) -> Array:
        """Return simulated outputs (k, columns)."""
        return self._evaluate("output", at)[1]

    # --- linearization

    def linearize(self, at: Course, weight: Array) -> Linearization:
        """Linearize along a trajectory, the residuals multiplied by `weight`.

        The weight is a square root of the inverse covariance.

        It is one (k, k) for all segments, or one for every record (r, k, k).
        """
        n = self.n
        v = n + len(self.active)
        slopes = np.empty((self.count, n, v))
        by_nodes = np.empty((self.count, n, v + 1))
        by_parameters = np.zeros((self.number, v - n + 1, v - n + 1))

        for batch in self.batches():
            ends, J = self.sensitivities(at, batch, weight)
            # The residuals are the last column: one product has the Hessian and the gradient.
            H = J.mT @ J
            slopes[batch] = ends
            by_nodes[batch] = H[:, :n]
            by_parameters += self.by_record(H[:, n:, n:], batch)

        return Linearization(
            transition=slopes[:, :, :n],
            parameter_sensitivity=slopes[:, :, n:],
            node_hessian=by_nodes[:, :, :n],
            cross_hessian=by_nodes[:, :, n:v],
            node_gradient=by_nodes[:, :, v],
            parameter_hessian=by_parameters[:, :-1, :-1],
            parameter_gradient=by_parameters[:, :-1, -1],
        )

    def sensitivities(self, at: Course, batch: slice, weight: Array) -> tuple[Array, Array]:
        """Return the derivatives of the c segments of a `batch` by node and active parameters.

        The first array (c, n, v) has the derivatives of the ends. The second array (c, r, v + 1)
        has the derivatives of the weighted residuals, and in its last column these residuals. The
        rows are the `weight` times the residuals (k,) of every sample, see `linearize`.
        """
        states = at.states.reshape(-1, self.length, self.count)[:, :, batch]
        data = at.data.reshape(-1, self.length, self.count)[:, :, batch]
        q = at.q[:, batch] if self._own else at.q
        columns = data[0].size
        part = Course(states.reshape(-1, columns), q, data.reshape(-1, columns))
        slopes, e = _finite(self._evaluate("derivatives", part))
        ends, J = self.propagated(slopes)
        rows = np.concatenate([J.T, e.reshape(1, self.k, self.length, -1)])
        # One product for every direction, instead of one for every sample.
        weights = weight[None] if weight.ndim == 2 else weight[self.records[batch]]
        J = np.einsum("cab,vblc->clav", weights, rows)
        return ends, J.reshape(len(ends), -1, len(rows))

    def sample_derivatives(self, at: Course) -> Array:
        """Return derivatives (columns, n + k, v) of next states and residuals of every sample.

        The derivatives are with respect to the state at the sample and the active parameters.
        """
        slopes, _ = _finite(self._evaluate("derivatives", at))
        return np.ascontiguousarray(slopes.reshape(-1, self.n + self.k, slopes.shape[1]).T)

    def output_sensitivities(self, at: Course) -> Array:
        """Return the derivatives (s, length, k, v) of the simulated outputs at all samples.

        They are not finite from the sample on where the simulation is not.
        """
        slopes, _ = self._evaluate("output_derivatives", at)
        return self.propagated(slopes)[1]

    def propagated(self, slopes: Array) -> tuple[Array, Array]:
        """Carry the derivatives of every sample through c segments.

        The slopes are the derivatives of next states and rows (n + k) with respect to the v states
        and parameters at a sample.

        Returns the derivatives of the ends (c, n, v) and of the rows (c, length, k, v).
        """
        n = self.n
        # CasADi stacks them column by column.
        slopes = slopes.reshape(-1, n + self.k, self.length, slopes.shape[1] // self.length)
        if n > FEW_STATES:  # products of stacked matrices are fast for contiguous ones
            slopes = np.ascontiguousarray(slopes.T).T
        S = np.zeros_like(slopes[:, :n, 0])
        S[range(n), range(n)] = 1
        rows = np.empty_like(slopes[:, n:])
        for i in range(self.length):
            slope = slopes[:, :, i]
            if n > FEW_STATES:
                following = (slope[:n].T @ S.T).T
            else:
                following = np.einsum("jic,vjc->vic", slope[:n], S)
            # The parameters also act at this very sample, besides through the state.
            following[n:] += slope[n:]
            S = following[:, :n]
            rows[:, :, i] = following[:, n:]

        return S.T, rows.T

    def mean_transition(self, at: Course) -> tuple[Array, Array]:
        """Return the mean derivatives of next state (n, n) and outputs (k, n) by the state."""
        # 500 samples, evenly over the record, cost a twelfth of 6000.
        sample = slice(None, None, max(at.states.shape[1] // 500, 1))
        along = Course(at.states[:, sample], at.q, at.data[:, sample])
        slopes = self.sample_derivatives(along)[..., : self.n].mean(axis=0)
        return slopes[: self.n], -slopes[self.n :]

    def batches(self) -> list[slice]:
        """Return slices of segments whose derivatives fit into memory together."""
        # Batches of equal size need only one layout of the registers.
        size = math.ceil(self.count / math.ceil(self.count / max(BATCH // self.length, 1)))
        return [slice(first, first + size) for first in range(0, self.count, size)]


def _finite(values: Sequence[Array]) -> list[Array]:
    """Return derivatives with zeros for non-finite ones, as 0 · inf of sqrt(max(h, 0))."""
    return [
        v if math.isfinite(v.sum()) else np.nan_to_num(v, nan=0.0, posinf=0.0, neginf=0.0)
        for v in values
    ]


class SubstepDerivatives:
    """Derivatives of the next state and an output, as one function of a sample would return them.

    The derivatives are with respect to the state and the `active` parameters. The output is the
    residual or the simulated output, depending on the name of the function in `Segments`. Substeps
    are distinguished by their identity.
    """

    def __init__(
        self,
        measurement: ca.Function,
        substep: ca.Function,
        identity: int,
        name: str,
        active: tuple[int, ...],
        shared: tuple[int, ...],
    ) -> None:
        x, q, d = measurement.sx_in()
        corrected, mean, change, residual, output = measurement(x, q, d)
        parameters = as_column(q[i] for i in active)
        place = ca.SX.sym("place", 2)  # where in a sample a substep begins, and its share of it
        p = q[: substep.size1_in(3)]
        end = substep(x, mean + change * place[0], change / d[-1], p, d[-1] * place[1])

        if name == "derivatives":
            output = residual
        by_free = dense_jacobian(output, ca.vertcat(x, parameters))
        self._active = len(active)
        begin, self._corrected = _with_slopes(corrected, x, parameters)
        further, self._following = _with_slopes(end, x, parameters)

        def columns(inputs: list[ca.SX], outputs: list[ca.SX]) -> Columns:
            return Columns(ca.Function("substep", inputs, outputs, {"cse": True}), shared)

        self._begin = columns([x, q, d], [*begin, by_free, residual])
        self._advance = columns([x, q, d, place], [end])
        self._substep = columns([x, q, d, place], [*further])

    def __call__(self, substeps: int, states: Array, q: Array, data: Array) -> Sequence[Array]:
        """Return the derivatives ((n + k) v, columns), and the residuals."""
        n, columns = states.shape
        slopes = np.tile(np.eye(n, n + self._active), (columns, 1, 1))
        x, values, by_parameters, by_free, residual = self._begin(states, q, data)
        slopes = _following(_blocks(self._corrected, columns), values, by_parameters, slopes)
        blocks = _blocks(self._following, columns)
        # The states of a group of substeps are computed first, then the derivatives of all of them
        # together: an operation on the columns of a group takes hardly longer than on the columns
        # of one substep. Groups of equal size need only one layout of the registers.
        places = [[[k / substeps - 0.5], [1 / substeps]] for k in range(substeps)]
        rows = np.tile(places, columns)
        for group in np.array_split(rows, math.ceil(substeps / (CHUNK // (columns + 1) + 1))):
            begins = [x[:, -columns:]]
            count = len(group)
            for place in group[:-1]:
                begins += self._advance(begins[-1], q, data, place)
            x, *parts = self._substep(
                np.hstack(begins),
                q if q.ndim == 1 else np.tile(q, count),
                np.tile(data, count),
                np.hstack([*group]),
            )
            for values, by_parameters in zip(
                *(np.split(part, count, axis=1) for part in parts), strict=True
            ):
                slopes = _following(blocks, values, by_parameters, slopes)

        by_free = by_free.reshape(len(slopes.T), -1, columns)
        return [np.hstack([slopes.T, by_free]).reshape(-1, columns), residual]


# This function is separate from the class: workers get these derivatives with their solver, and
# pickle finds no class under a name that `once` gave to a function.
substep_derivatives = once(SubstepDerivatives)


def _with_slopes(
    value: ca.SX, x: ca.SX, parameters: ca.SX
) -> tuple[tuple[ca.SX, ca.SX, ca.SX], ca.Sparsity]:
    """Return the value and its derivatives with respect to x and the parameters, and a pattern.

    The derivatives with respect to x are the nonzero entries, row by row. The pattern is the
    sparsity of the transposed derivatives with respect to x.
    """
    by_state = ca.jacobian(value, x).T
    by_parameters = dense_jacobian(value, parameters)
    return (value, ca.vec(by_state.nz[:]), by_parameters), by_state.sparsity()


def _blocks(pattern: ca.Sparsity, columns: int) -> Any:
    """Return a matrix with a block of this pattern, transposed, for every column."""
    from scipy.sparse import csr_matrix  # noqa: PLC0415  (most models do not need the import)

    n = pattern.size1()
    block = np.arange(columns)[:, None]
    ends = (np.array(pattern.colind()[1:]) + pattern.nnz() * block).ravel()
    places = (np.array(pattern.row(), dtype=int) + n * block).ravel()
    values = np.empty(len(places))
    return csr_matrix((values, places, np.append(0, ends)), shape=2 * (n * columns,))


def _following(blocks: Any, values: Array, by_parameters: Array, slopes: Array) -> Array:
    """Return the derivatives (columns, n, v) after a function with these derivatives.

    The `values` (entries, columns) are its derivatives with respect to x, which fill the blocks.
    """
    columns, n, v = slopes.shape
    blocks.data = values.T.ravel()
    result = (blocks @ slopes.reshape(-1, v)).reshape(slopes.shape)
    result[..., n:] += by_parameters.reshape(v - n, n, columns).T
    return result
