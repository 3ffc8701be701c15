"""Trajectories of many segments of equal length at once: states, outputs, and the outputs' sensitivities."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.sample_step import SampleStep

Array = NDArray[np.float64]


class Trajectories:
    """Simulations of `count` segments of `length` samples, each from its own state; compiled when first asked for.

    `active` names the parameters by which outputs are differentiated. The columns of the data are samples, one segment
    after the other, as `SampleStep` describes them.
    """

    def __init__(self, step: SampleStep, count: int, length: int, active: NDArray[np.integer]) -> None:
        self._step = step
        self._count = count
        self._length = length
        self._active = active
        self._n = step.function.size1_in(0)
        self._k = step.function.size1_out(2)
        self._functions: dict[str, ca.Function] = {}

    def simulate(self, initial: Array, q: Array, data: ca.DM) -> tuple[Array, Array]:
        """Return states (count, length, n) and outputs (count, length, k) from the initial states (count, n)."""
        if "outputs" not in self._functions:
            self._functions["outputs"] = self._outputs().map(self._count)
        states, outputs = self._functions["outputs"](initial.T, q, data)
        return self._by_segment(states.full()), self._by_segment(outputs.full())

    def sensitivities(self, initial: Array, q: Array, data: ca.DM) -> Array:
        """Return the outputs' derivatives by the initial state and the active parameters, (count, length, k, n + a)."""
        if "sensitivities" not in self._functions:
            self._functions["sensitivities"] = self._sensitivities().map(self._count)
        flat = self._by_segment(self._functions["sensitivities"](initial.T, q, data).full())
        return flat.reshape(self._count, self._length, self._n + len(self._active), self._k).transpose(0, 1, 3, 2)

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
        following, _, y = self._step.function(x, q, d)
        step = ca.Function("step", [x, q, d], [following, x, y], {"cse": True})

        initial, Q, D = self._arguments()
        _, states, outputs = step.mapaccum(self._length)(initial, Q, D)
        return ca.Function("outputs", [initial, Q, D], [states, outputs])

    def _sensitivities(self) -> ca.Function:
        x, q, d = self._symbols()
        n = self._n
        columns = n + len(self._active)
        S = ca.SX.sym("S", n, columns)
        following, _, y = self._step.function(x, q, d)
        free = ca.vertcat(x, *(q[i] for i in self._active.tolist()))
        A = ca.jacobian(following, free)
        C = ca.jacobian(y, free)
        S_following = A[:, :n] @ S + ca.horzcat(ca.SX(n, n), A[:, n:])
        by_output = C[:, :n] @ S + ca.horzcat(ca.SX(self._k, n), C[:, n:])

        state = ca.vertcat(x, ca.vec(S))
        state_following = ca.vertcat(following, ca.vec(S_following))
        step = ca.Function("step", [state, q, d], [state_following, ca.vec(by_output)], {"cse": True})

        initial, Q, D = self._arguments()
        start = ca.vertcat(initial, ca.vec(ca.DM(np.eye(n, columns))))
        _, sensitivities = step.mapaccum(self._length)(start, Q, D)
        return ca.Function("sensitivities", [initial, Q, D], [ca.densify(sensitivities)])

    def _arguments(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        size = self._step.function.size1_in(1)
        return ca.MX.sym("x", self._n), ca.MX.sym("q", size), ca.MX.sym("d", self._step.width, self._length)
