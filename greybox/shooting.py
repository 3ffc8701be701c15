"""One record compiled for multiple shooting: a step with its sensitivities, folded over segments, mapped over a record.

The data are cut into segments; the state at the beginning of each is an unknown, and continuity from one to the next a
constraint (Bock 1983, Recent advances in parameter identification techniques for ODE). Here is what one evaluation
gives: ends of the segments and residuals, or the blocks of the Gauss-Newton system.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.dynamics import Dynamics
from greybox.experiment import Experiment, input_over_step
from greybox.integrator import Integrator, step_function
from greybox.output_error import PredictionError, TimeCriterion

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Blocks:
    """Linearization of one record at its node states (s, n) and parameters (q,): ends, their derivatives, and JᵀJ, Jᵀe.

    Segments come first: `end` (s, n), `to_state` (s, n, n), `to_parameters` (s, n, q), `hessian` (s, v, v) and
    `gradient` (s, v) with v = n + q, of the weighted squared residuals.
    """

    end: Array
    to_state: Array
    to_parameters: Array
    hessian: Array
    gradient: Array


@dataclass(frozen=True, eq=False)
class SampleStep:
    """What happens at one sample, in CasADi: states x (n,), parameters q, data d -> next state, residual, output.

    Attributes
    ----------
    function : casadi.Function
        (x, q, d) -> x one sample later, residuals of the measured outputs (zero where missing), simulated outputs.
    width : int
        Length of d: whole samples of delay (m), windows of the inputs (3 m), outputs (k), present (k), step.
    """

    function: ca.Function
    width: int


def sample_step(
    system: Dynamics,
    criterion: TimeCriterion,
    outputs: tuple[str, ...],
    names: tuple[str, ...],
    integrator: Integrator,
    substeps: int,
) -> SampleStep:
    """Compile one sample of the declared parameters `names`: the model's first, then the criterion's."""
    n, m, k = len(system.states), len(system.inputs), len(outputs)
    x, q = ca.SX.sym("x", n), ca.SX.sym("q", len(names))
    whole, window = ca.SX.sym("whole", m), ca.SX.sym("window", 3 * m)
    measured, present, step = ca.SX.sym("y", k), ca.SX.sym("present", k), ca.SX.sym("step")
    p = q[: len(system.parameters)]
    delay = system.delay(p)
    bias = {name: q[names.index(f"{name}_bias")] for name in criterion.biases}
    means, changes, nows = [], [], []
    for i, name in enumerate(system.inputs):
        fraction = ca.SX(0) if delay[i].is_zero() else delay[i] / step - whole[i]
        mean, change, now = input_over_step(window[3 * i : 3 * i + 3], fraction, criterion.inputs == "held")
        means.append(mean - bias.get(name, 0))
        changes.append(change)
        nows.append(now - bias.get(name, 0))
    mean, change, now = (ca.vertcat(ca.SX(0, 1), *values) for values in (means, changes, nows))
    rows = [system.outputs.index(name) for name in outputs]
    simulated = system.output(x, now, p)[rows] + ca.vertcat(*[bias.get(name, 0) for name in outputs])
    residual = present * (measured - simulated)
    corrected = ca.SX(x)  # a copy: assignment to its entries below would change the symbol
    if isinstance(criterion, PredictionError):
        for state in system.states:
            for j, output in enumerate(outputs):
                if f"K_{state}_{output}" in names:
                    place = system.states.index(state)
                    corrected[place] += q[names.index(f"K_{state}_{output}")] * residual[j]
    after = step_function(system, integrator, substeps)(corrected, mean, change, p, step)
    data = ca.vertcat(whole, window, measured, present, step)
    function = ca.Function("sample", [x, q, data], [after, residual, simulated], {"cse": True})
    return SampleStep(function, data.numel())


class Shooting:
    """The functions of one record, for the parameters that `active` names (those that are estimated)."""

    def __init__(
        self, step: SampleStep, experiment: Experiment, active: NDArray[np.integer], compiled: bool = False
    ) -> None:
        self.experiment, self.active, self._compiled = experiment, active, compiled
        self._step = step
        self.n, self.size = step.function.size1_in(0), step.function.size1_in(1)
        self.k = step.function.size1_out(1)
        measured = experiment.measured
        present = np.isfinite(measured)
        self.counts = present.sum(axis=1)
        self._fixed = np.vstack([np.nan_to_num(measured), present, experiment.steps])
        self._data: ca.DM | None = None
        self._whole: Any = None
        self._functions: dict[str, ca.Function] = {}

    def data(self, delays: Array) -> ca.DM:
        """Return the data of all samples, (width, samples), windows placed for these delays (m,)."""
        key = tuple(np.floor(np.asarray(delays)[:, None] / [s.step for s in self.experiment.stretches] + 1e-9).ravel())
        if self._data is None or key != self._whole:
            whole, windows = self.experiment.windows(delays)
            self._data = ca.DM(np.vstack([whole, windows, self._fixed]))
            self._whole = key
        return self._data

    def ends(self, nodes: Array, q: Array, data: ca.DM) -> tuple[Array, Array]:
        """Return the ends of the segments (s, n) and the sums of residual products (k, k)."""
        function = self._function("ends", self._ends)
        end, products = function(nodes.T, q, data)
        return end.full().T, _symmetric(products.full().sum(axis=1)[None], self.k)[0]

    def blocks(self, nodes: Array, q: Array, weight: Array, data: ca.DM) -> Blocks:
        """Linearize with the residuals multiplied by `weight` (k, k), a square root of the inverse covariance."""
        function = self._function("blocks", self._blocks)
        end, slope, products, gradient = (v.full().T for v in function(nodes.T, q, weight, data))
        s, v = len(end), self.n + len(self.active)
        slope = slope.reshape(s, v, self.n).transpose(0, 2, 1)
        return Blocks(end, slope[:, :, : self.n], slope[:, :, self.n :], _symmetric(products, v), gradient)

    def simulate(self, nodes: Array, q: Array, data: ca.DM) -> tuple[Array, Array]:
        """Return states (n, samples) and simulated outputs (k, samples), every segment from its node."""
        states, outputs = self._function("outputs", self._outputs)(nodes.T, q, data)
        return states.full(), outputs.full()

    def sensitivities(self, nodes: Array, q: Array, data: ca.DM) -> Array:
        """Return the derivatives of the simulated outputs by node and active parameters, (samples, k, v)."""
        slopes = self._function("slopes", self._slopes)(nodes.T, q, data).full()
        samples, v = slopes.shape[1], self.n + len(self.active)
        return slopes.T.reshape(samples, v, self.k).transpose(0, 2, 1)

    def _function(self, name: str, build: Any) -> ca.Function:
        if name not in self._functions:
            self._functions[name] = build().map(self.experiment.segments)
        return self._functions[name]

    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        return ca.SX.sym("x", self.n), ca.SX.sym("q", self.size), ca.SX.sym("d", self._step.width)

    def _ends(self) -> ca.Function:
        """(node, q, data) -> end, upper triangle of the sum of residual products."""
        x, q, d = self._symbols()
        after, e, _ = self._step.function(x, q, d)
        total = ca.SX.sym("total", self.k * (self.k + 1) // 2)
        step = ca.Function("step", [ca.vertcat(x, total), q, d], [ca.vertcat(after, total + _upper(e @ e.T))])
        node, Q, D = self._arguments()
        last = step.fold(self.experiment.segment)(ca.vertcat(node, ca.MX.zeros(total.numel())), Q, D)
        return ca.Function("ends", [node, Q, D], [last[: self.n], last[self.n :]])

    def _blocks(self) -> ca.Function:
        """(node, q, weight, data) -> end, its derivatives (n v), upper triangle of JᵀJ, Jᵀe."""
        x, q, d = self._symbols()
        n, v = self.n, self.n + len(self.active)
        W = ca.SX.sym("W", self.k, self.k)
        S = ca.SX.sym("S", n, v)
        H, g = ca.SX.sym("H", v * (v + 1) // 2), ca.SX.sym("g", v)
        after, e, _ = self._step.function(x, q, d)
        free = ca.vertcat(x, q[self.active.tolist()])
        A, E = ca.jacobian(after, free), W @ ca.jacobian(e, free)
        S_next = A[:, :n] @ S + ca.horzcat(ca.SX(n, n), A[:, n:])
        J = E[:, :n] @ S + ca.horzcat(ca.SX(self.k, n), E[:, n:])
        state = ca.vertcat(x, ca.vec(S), H, g)
        out = ca.vertcat(after, ca.vec(S_next), H + _upper(J.T @ J), g + J.T @ (W @ e))
        step = ca.Function("step", [state, q, W, d], [out], {"cse": True})
        node, Q, D = self._arguments()
        weight = ca.MX.sym("W", self.k, self.k)
        eye = ca.DM(np.eye(n, v))
        begin = ca.vertcat(node, ca.vec(eye), ca.MX.zeros(H.numel() + v))
        last = step.fold(self.experiment.segment)(begin, Q, weight, D)
        ends = np.cumsum([n, n * v, H.numel(), v])
        parts = ca.vertsplit(last, [0, *ends.tolist()])
        return ca.Function("blocks", [node, Q, weight, D], parts)

    def _outputs(self) -> ca.Function:
        x, q, d = self._symbols()
        after, _, y = self._step.function(x, q, d)
        step = ca.Function("step", [x, q, d], [after, x, y])
        node, Q, D = self._arguments()
        _, states, outputs = step.mapaccum(self.experiment.segment)(node, Q, D)
        return ca.Function("outputs", [node, Q, D], [states, outputs])

    def _slopes(self) -> ca.Function:
        x, q, d = self._symbols()
        n, v = self.n, self.n + len(self.active)
        S = ca.SX.sym("S", n, v)
        after, _, y = self._step.function(x, q, d)
        free = ca.vertcat(x, q[self.active.tolist()])
        A, C = ca.jacobian(after, free), ca.jacobian(y, free)
        S_next = A[:, :n] @ S + ca.horzcat(ca.SX(n, n), A[:, n:])
        J = C[:, :n] @ S + ca.horzcat(ca.SX(self.k, n), C[:, n:])
        step = ca.Function("step", [ca.vertcat(x, ca.vec(S)), q, d], [ca.vertcat(after, ca.vec(S_next)), ca.vec(J)])
        node, Q, D = self._arguments()
        _, slopes = step.mapaccum(self.experiment.segment)(ca.vertcat(node, ca.vec(ca.DM(np.eye(n, v)))), Q, D)
        return ca.Function("slopes", [node, Q, D], [slopes])

    def _arguments(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        width = self._step.width
        return ca.MX.sym("node", self.n), ca.MX.sym("q", self.size), ca.MX.sym("d", width, self.experiment.segment)


def _upper(matrix: ca.SX) -> ca.SX:
    """Stack the upper triangle, row by row."""
    v = matrix.size1()
    return ca.vertcat(*[matrix[i, k] for i in range(v) for k in range(i, v)]) if v else ca.SX(0, 1)


def _symmetric(rows: Array, v: int) -> Array:
    """Undo `_upper` for every row: (s, v (v + 1) / 2) to (s, v, v)."""
    i, k = np.triu_indices(v)
    result = np.empty((len(rows), v, v))
    result[:, i, k] = rows
    result[:, k, i] = rows
    return result
