"""A sample of a model folded over segments of equal length: outputs, states, and their derivatives, of all at once."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.sample_step import SampleStep

Array = NDArray[np.float64]


class Flow:
    """Simulations of `count` segments of `length` samples, each from its own state; compiled when first asked for.

    `active` names the parameters by which outputs are differentiated. The columns of the data are samples, one segment
    after the other, as `SampleStep` describes them.
    """

    def __init__(self, step: SampleStep, count: int, length: int, active: NDArray[np.integer]) -> None:
        self._step, self._count, self._length, self._active = step, count, length, active
        self._n, self._k = step.function.size1_in(0), step.function.size1_out(2)
        self._functions: dict[str, ca.Function] = {}

    def simulate(self, nodes: Array, q: Array, data: ca.DM) -> tuple[Array, Array]:
        """Return states (count, length, n) and outputs (count, length, k) from the states `nodes` (count, n)."""
        if "outputs" not in self._functions:
            self._functions["outputs"] = self._outputs().map(self._count)
        states, outputs = self._functions["outputs"](nodes.T, q, data)
        return self._by_segment(states.full()), self._by_segment(outputs.full())

    def slopes(self, nodes: Array, q: Array, data: ca.DM) -> Array:
        """Return the derivatives of the outputs by the node and the active parameters, (count, length, k, n + a)."""
        if "slopes" not in self._functions:
            self._functions["slopes"] = self._slopes().map(self._count)
        found = self._by_segment(self._functions["slopes"](nodes.T, q, data).full())
        return found.reshape(self._count, self._length, self._n + len(self._active), self._k).transpose(0, 1, 3, 2)

    def _by_segment(self, values: Array) -> Array:
        return values.T.reshape(self._count, self._length, len(values))

    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        return (
            ca.SX.sym("x", self._n),
            ca.SX.sym("q", self._step.function.size1_in(1)),
            ca.SX.sym("d", self._step.width),
        )

    def _outputs(self) -> ca.Function:
        x, q, d = self._symbols()
        after, _, y = self._step.function(x, q, d)
        step = ca.Function("step", [x, q, d], [after, x, y], {"cse": True})
        node, Q, D = self._arguments()
        _, states, outputs = step.mapaccum(self._length)(node, Q, D)
        return ca.Function("outputs", [node, Q, D], [states, outputs])

    def _slopes(self) -> ca.Function:
        x, q, d = self._symbols()
        n, v = self._n, self._n + len(self._active)
        S = ca.SX.sym("S", n, v)
        after, _, y = self._step.function(x, q, d)
        free = ca.vertcat(x, *(q[i] for i in self._active.tolist()))
        A, C = ca.jacobian(after, free), ca.jacobian(y, free)
        S_next = A[:, :n] @ S + ca.horzcat(ca.SX(n, n), A[:, n:])
        J = C[:, :n] @ S + ca.horzcat(ca.SX(self._k, n), C[:, n:])
        state = ca.vertcat(x, ca.vec(S))
        step = ca.Function("step", [state, q, d], [ca.vertcat(after, ca.vec(S_next)), ca.vec(J)], {"cse": True})
        node, Q, D = self._arguments()
        _, slopes = step.mapaccum(self._length)(ca.vertcat(node, ca.vec(ca.DM(np.eye(n, v)))), Q, D)
        return ca.Function("slopes", [node, Q, D], [ca.densify(slopes)])

    def _arguments(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        size = self._step.function.size1_in(1)
        return ca.MX.sym("node", self._n), ca.MX.sym("q", size), ca.MX.sym("d", self._step.width, self._length)
