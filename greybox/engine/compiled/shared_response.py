"""Many responses of one state space, from one solve of (jωI - A)⁻¹ at each frequency.

With S = [[A, B], [C, D]], X = (jωI - A)⁻¹ B and Y = C (jωI - A)⁻¹ the responses are G = C X + D,
and their derivatives with respect to a parameter are

    dG = [Y, I] dS [X; I],

so that outputs, parameters and points share one inverse. As one expression, the 30 responses of a
helicopter at 20 frequencies have a hundred thousand operations, and their Hessian has millions.

The Hessian of a criterion φ is composed as Jᵀ φ'' J (Gauss-Newton): the omitted term, Σ φ' r'', is
small where the residuals are, and may be indefinite far away from a minimum.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, BoolArray, ComplexArray, IntArray, real_and_imaginary
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.vectorized import Columns
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.fingerprint import function_key
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.held_inputs import first_terms, folded_back
from greybox.modeling.linearization import jacobians
from greybox.modeling.model import pick_signals
from greybox.modeling.state_space import input_delays
from greybox.modeling.symbolic_reading import as_column, dense_jacobian, parameter_names
from greybox.modeling.trim import trim_of

# Step of differences, as a share of a start box: third derivatives and rounding disturb a Hessian
# by less than a millionth.
DIFFERENCE = 1e-7


@frozen
class SharedSystem:
    """One state space at one operating point, for some of the responses of a problem.

    Attributes
    ----------
    states, inputs, outputs : int
        Their numbers n, m, l.
    omega : (w,) array, rad/s
        All frequencies of its responses.
    rows : (e, 2) array of int
        Places in S (n + l, n + m) of the entries that are not always zero.
    entries : Columns
        (z) -> these entries and the delays of the inputs, (e + m,), and their derivatives by z,
        (e + m, p), column by column.
    pairs : tuple of (part, points)
        The points (3, n) of a part: outputs, inputs, and places in `omega`.
    delayed : (m,) bool array
        Which inputs have delays.
    hold : float, s
        See `folded_back`.
    """

    states: int
    inputs: int
    outputs: int
    omega: Array
    rows: IntArray
    entries: Columns
    pairs: tuple[tuple[int, IntArray], ...]
    delayed: BoolArray
    hold: float

    def matrices(self, z: Array) -> tuple[Array, Array, IntArray, Array, Array]:
        """Return S (k, n + l, n + m), delays (k, m), and their derivatives by z (p, k).

        Only some entries depend on z: their places (2, e), and derivatives (k, e, p). The last
        derivatives are those of the delays (k, m, p).
        """
        values, slopes = self.entries(z)
        count = len(self.rows)
        S = np.zeros((z.shape[1], self.states + self.outputs, self.states + self.inputs))
        S[:, self.rows[:, 0], self.rows[:, 1]] = values[:count].T
        slopes = slopes.T.reshape(z.shape[1], len(z), -1).mT
        moving = np.flatnonzero(np.any(slopes[:, :count] != 0, axis=(0, 2)))
        return S, values[count:].T, self.rows[moving].T, slopes[:, moving], slopes[:, count:]

    def of_pairs(self) -> Iterator[tuple[int, "SharedSystem"]]:
        """Yield every part with the system of its response alone."""
        for part, (*signals, at) in self.pairs:
            points = np.array([*signals, range(len(at))])
            yield part, replace(self, omega=self.omega[at], pairs=((part, points),))

    def responses(self, z: Array) -> tuple[ComplexArray, ComplexArray]:
        """Return the points of all pairs at z (p, k), (k, N), and their derivatives, (k, p, N)."""
        # Pairs have frequencies of their own: derivatives are computed where one is measured.
        points = np.hstack([own for _, own in self.pairs])
        S, delays, *by_z, delay_slopes = self.matrices(z)
        undelayed = partial(self._undelayed, S, *by_z, points)
        _, inputs, at = points
        s, late = 1j * self.omega[at], delays[:, None, inputs]
        result = undelayed(self.omega)
        by_delay: Any = 0.0
        if self.hold:
            at_once, rate = first_terms(
                lambda q: undelayed(np.full(self.omega.shape, q / 1j)), self.hold
            )
            step, ramp, slope = folded_back(s * self.hold, late / self.hold)
            result += ramp * rate + np.where(self.delayed[inputs], 0, step) * at_once
            by_delay = slope * rate[:, :1] / self.hold
        by_delay = by_delay - s * result[:, :1]
        moving = np.flatnonzero(np.any(delay_slopes != 0, axis=(0, 1)))
        result[:, 1 + moving] += by_delay * delay_slopes[..., moving].mT[..., inputs]
        result *= np.exp(-s * late)
        return result[:, 0], result[:, 1:]

    def _undelayed(
        self, S: Array, places: IntArray, slopes: Array, points: IntArray, omega: Any
    ) -> ComplexArray:
        """Return responses and derivatives at points (3, N) for inputs without delays."""
        n = self.states
        inverse = resolvents(S[:, :n, :n], omega)
        X = inverse @ S[:, None, :n, n:]
        Y = S[:, None, n:, :n] @ inverse
        outputs, inputs, at = points
        left, right = _at_points(Y, outputs, at), _at_points(X.mT, inputs, at)
        response = np.sum(S[:, n + outputs].mT * right, 1, keepdims=True)
        i, j = places
        by_entry = (left[:, i] * right[:, j]).view(float)
        by_z = (slopes.mT @ by_entry).view(complex)
        return np.concatenate([response, by_z], 1)


def _at_points(side: ComplexArray, signals: IntArray, at: IntArray) -> ComplexArray:
    """Return a side (k, w, l, n) with an identity beside it, at N points: (k, n + l, N).

    The side is that of the inputs or outputs, of which each point has one of the `signals`.
    """
    count = side.shape[2]
    identity = np.broadcast_to(np.eye(count), (*side.shape[:3], count))
    rows = np.moveaxis(np.concatenate([side, identity], -1), -1, 1)
    # `take` leaves the rows of all points contiguous, which indices of arrays do not.
    return rows.reshape(*rows.shape[:2], -1).take(at * count + signals, -1)


def resolvents(A: Array, omega: Array) -> ComplexArray:
    """Return (jωI - A)⁻¹ (k, w, n, n); NaN for all if a pole is at a frequency."""
    pencil = 1j * omega[:, None, None] * np.eye(A.shape[-1]) - A[:, None]
    try:
        return np.linalg.inv(pencil)
    except np.linalg.LinAlgError:  # such trials are refused
        return np.full_like(pencil, np.nan)


class SharedResponses:
    """The cost of many responses, with its gradient and Gauss-Newton Hessian, for many points.

    Attributes
    ----------
    systems : sequence of SharedSystem
    data : list of complex arrays
        The measured responses of all parts.
    """

    def __init__(
        self,
        parts: Sequence[Problem],
        systems: Sequence[SharedSystem],
        cost: ca.SX,
        symbols: Sequence[ca.SX],
    ) -> None:
        """Take the cost as an expression of symbols: responses; smoothing; data.

        The responses are those of one system after the other, real parts before imaginary parts.
        """
        self.systems = systems
        self.data = [part.response.response for part in parts]
        second, first = ca.hessian(cost, symbols[0])
        self._second = np.array(second.sparsity().get_triplet())
        outputs = [cost, first, second.nz[:]]
        self._criterion = Columns(ca.Function("criterion", [*symbols], outputs))

    def __call__(self, z: Array, smoothing: Array, data: Array) -> tuple[Array, Array, Array]:
        """Return cost (k,), gradient (p, k), Hessian (p * p, k) at z (p, k), smoothing (1, k).

        The columns of `data` (g, k) are those of `CompiledProblem`.
        """
        cost, gradient, jacobian, second = self._derivatives(z, smoothing, data)
        rows, columns = self._second
        left = jacobian.take(rows, -1)
        right = jacobian.take(columns, -1)
        hessian = left @ (right * second.T[:, None]).mT
        return cost, gradient, hessian.reshape(len(hessian), -1).T

    def with_curvature(self, z: Array, smoothing: Array, data: Array) -> tuple[Array, Array, Array]:
        """Return the same with the whole Hessian, by differences of the gradient.

        With large residuals, as of a wrong model, the curvature of the responses counts.
        """
        cost, gradient, *_ = self._derivatives(z, smoothing, data)
        p, k = z.shape
        # Inward, at most: a model may end at its bounds. Variables are shares of a start box.
        step = np.where(z > 0, -DIFFERENCE, DIFFERENCE)
        columns = np.empty((p, p, k))
        for i in range(p):
            beside = z.copy()
            beside[i] += step[i]
            columns[i] = (self._derivatives(beside, smoothing, data)[1] - gradient) / step[i]
        hessian = (columns + columns.swapaxes(0, 1)) / 2
        return cost, gradient, hessian.reshape(p * p, k)

    def _derivatives(
        self, z: Array, smoothing: Array, data: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return cost (k,), gradient (p, k), Jacobian (k, p, 2 N), second derivatives (n, k)."""
        with np.errstate(all="ignore"):
            pieces = zip(*(system.responses(z) for system in self.systems), strict=True)
        # All responses (k, N), and their derivatives (k, p, N).
        all_values, all_slopes = pieces
        values = np.concatenate(all_values, -1)
        slopes = np.concatenate(all_slopes, -1)
        cost, first, second = self._criterion(real_and_imaginary(values, 1).T, smoothing, data)
        jacobian = real_and_imaginary(slopes, 2)
        gradient = jacobian @ first.T[..., None]
        return cost[0], gradient[..., 0].T, jacobian, second


def response_symbols(parts: Sequence[Problem]) -> tuple[Any, list[Complex]]:
    """Return symbols of all responses, real parts before imaginary parts, and each response."""
    ends = np.cumsum([0, *(len(part.response) for part in parts)]).tolist()
    re = ca.SX.sym("re", ends[-1])
    im = ca.SX.sym("im", ends[-1])
    return ca.vertcat(re, im), [*map(Complex, ca.vertsplit(re, ends), ca.vertsplit(im, ends))]


def shared_systems(
    parts: Sequence[Problem], point: ca.SX, named: Mapping[str, Any]
) -> list[SharedSystem] | None:
    """Return the state spaces of all parts; None if one is not shared.

    The values by name are expressions of the `point` (p,). Operating points that Newton's method
    finds and Padé delays are not shared.
    """
    groups: dict[Any, list[int]] = {}
    values = [as_column(part.local_values(named).values()) for part in parts]
    local = [ca.Function("values", [point], [own]) for own in values]
    systems = []
    for k, part in enumerate(parts):
        if not part.model.state_names or part.delay != "exact":
            return None
        at = repr(sorted(part.at.items()))
        key = id(part.model), at, function_key(local[k]), part.sampled_hold
        groups.setdefault(key, []).append(k)
    for members in groups.values():
        systems.append(_system(parts, members, point, values[members[0]]))
    return None if None in systems else systems


def _system(
    parts: Sequence[Problem], members: Sequence[int], point: ca.SX, p: ca.SX
) -> SharedSystem | None:
    first = parts[members[0]]
    model: Any = first.model
    trim = trim_of(model, first.at)
    if trim.root is not None:
        return None
    A, B, C, D = jacobians(model)(p, *trim.function(p, ca.SX(0, 1)))
    system = ca.sparsify(ca.blockcat([[A, B], [C, D]]))
    delays = input_delays(model, parameter_names(model, p))
    values = ca.vertcat(system.nz[:], *delays.values())
    slopes = ca.vec(dense_jacobian(values, point))
    omega = np.unique(np.concatenate([parts[k].response.omega for k in members]))
    pairs = []
    for k in members:
        data = parts[k].response
        input, output = pick_signals(model, data.input, data.output)
        places = model.output_names.index(output), model.input_names.index(input)
        points = np.broadcast_arrays(*places, np.searchsorted(omega, data.omega))
        pairs.append((k, np.array(points)))
    return SharedSystem(
        states=A.shape[0],
        inputs=B.shape[1],
        outputs=C.shape[0],
        omega=omega,
        rows=np.array(system.sparsity().get_triplet(), dtype=int).T,
        entries=Columns(ca.Function("entries", [point], [values, slopes])),
        pairs=tuple(pairs),
        delayed=np.array([name in model.delays for name in model.inputs]),
        hold=first.sampled_hold,
    )
