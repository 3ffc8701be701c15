"""States to begin with: what the outputs show of them, and elsewhere a point at which the model has finite values.

Zero is where most models rest, and a better beginning than noisy measurements around it; what stays
away from zero begins as measured. A root, a logarithm or a division may exclude zero (the level of
a tank, an airspeed, a temperature). Then sizes over many decades are tried for the states that no
output shows, and the ones kept with which the model comes closest to the measured outputs.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from greybox.compiled.sampled_data import SampledData
from greybox.compiled.vectorized import Columns
from greybox.files.arrays import Array, BoolArray, ComplexArray, IntArray
from greybox.modeling.realization import Dynamics

GOLDEN = (
    5**0.5 - 1
) / 2  # whose multiples modulo one are spread more evenly than those of any other number
SWEEPS = 2  # over the unmeasured states, each of which tries all sizes
SIZES = (1.0, 0.1, 10.0, 0.01, 100.0, 1e-3, 1e3, 1e4, 1e5, -1.0, -0.1, -10.0, -100.0)


@dataclass(frozen=True, eq=False)
class Shown:
    """A state that an output shows: output = factor · state + offset."""

    state: int
    output: int
    factor: float
    offset: float


class InitialStates:
    """The states of a model at some samples, for the outputs that are compared."""

    def __init__(self, system: Dynamics, outputs: tuple[str, ...], *, scanned: bool = True) -> None:
        """Compile the model and its derivatives; with `scanned`, sizes are tried where it is not finite."""
        self._n = len(system.states)
        self._scanned = scanned
        x, u, p = (
            ca.SX.sym("v", len(v)) for v in (system.states, system.inputs, system.parameters)
        )
        y = system.output(x, u, p)[[system.outputs.index(name) for name in outputs]]
        f = system.derivative(x, u, p) if self._n else ca.SX(0, 1)
        slopes = ca.vertcat(
            ca.vec(ca.densify(ca.jacobian(f, x))), ca.vec(ca.densify(ca.jacobian(y, x)))
        )
        self._model = Columns(
            ca.Function("first", [x, u, p], [f, y, slopes], {"cse": True}), shared=(2,)
        )
        self._shown = _shown(y, x, ca.vertcat(u, p))

    def at(self, measured: Array, inputs: Array, p: Array, known: Array) -> Array:
        """Return states (n, s) for outputs (k, s) without gaps, inputs (m, s) and parameters; `known` (n,), else NaN.

        What is not finite anywhere is returned as zeros.
        """
        states, seen = np.zeros((self._n, inputs.shape[1])), np.zeros((self._n, inputs.shape[1]))
        hidden = np.ones(self._n, dtype=bool)
        seen = self.as_measured(seen, measured)
        hidden[[shown.state for shown in self._shown]] = False
        given = hidden & np.isfinite(known)
        states[given] = seen[given] = known[given, None]
        away = np.abs(seen.mean(axis=1)) > 0.5 * seen.std(axis=1)
        states[away] = seen[away]
        finite, _ = self._judged(states, measured, inputs, p)
        if finite.all() or not self._scanned:
            return states
        states = self._sized(seen, np.flatnonzero(hidden & ~given), measured, inputs, p)
        return self._mended(states, measured, inputs, p)

    def as_measured(self, states: Array, measured: Array) -> Array:
        """Return the states (n, s), those that outputs show as measured."""
        states = states.copy()
        for shown in self._shown:
            states[shown.state] = (measured[shown.output] - shown.offset) / shown.factor
        return states

    def poles(self, states: Array, inputs: Array, p: Array) -> ComplexArray:
        """Return the poles (s, n) of the linearizations at states (n, s), without those that are not finite."""
        matrices = self._model(states, inputs, p)[2][: self._n**2].T.reshape(
            inputs.shape[1], self._n, self._n
        )
        return np.linalg.eigvals(matrices[np.isfinite(matrices).all(axis=(1, 2))]).astype(complex)

    def _sized(
        self, states: Array, hidden: IntArray, measured: Array, inputs: Array, p: Array
    ) -> Array:
        """Return the states with the best sizes of the hidden ones: of all together, then of each."""
        best, least = states, self._score(states, measured, inputs, p)
        groups = [hidden] if hidden.size else []
        for group in [*groups, *([[k] for k in hidden] * SWEEPS)]:
            for size in (0.0, *SIZES):
                trial = best.copy()
                trial[group] = size
                score = self._score(trial, measured, inputs, p)
                if score < least:
                    best, least = trial, score
        return best

    def _mended(self, states: Array, measured: Array, inputs: Array, p: Array) -> Array:
        """Give samples at which the model is not finite the states of the nearest one where it is."""
        finite, _ = self._judged(states, measured, inputs, p)
        if not finite.any():
            return np.zeros_like(states)
        there = np.flatnonzero(finite)
        nearest = there[np.abs(np.arange(finite.size)[:, None] - there).argmin(axis=1)]
        return states[:, nearest]

    def _score(self, states: Array, measured: Array, inputs: Array, p: Array) -> tuple[int, float]:
        finite, missed = self._judged(states, measured, inputs, p)
        return int((~finite).sum()), float(missed[finite].sum())

    def _judged(
        self, states: Array, measured: Array, inputs: Array, p: Array
    ) -> tuple[BoolArray, Array]:
        """Return at which samples the model is finite (s,), and by how much its outputs miss (s,), in their spread."""
        f, y, slopes = self._model(states, inputs, p)
        finite = np.asarray(np.isfinite(np.vstack([f, y, slopes])).all(axis=0))
        scale = np.abs(measured).max(axis=1, initial=0.0, keepdims=True)
        with np.errstate(all="ignore"):
            return finite, (((y - measured) / np.where(scale > 0, scale, 1.0)) ** 2).sum(axis=0)


def _shown(y: ca.SX, x: ca.SX, others: ca.SX) -> list[Shown]:
    """Return the states that outputs show directly, by the first output that does."""
    found: dict[int, Shown] = {}
    slopes = ca.jacobian(y, x)
    mixed = ca.which_depends(y, others, 1, True) if others.numel() else [False] * y.numel()
    for k in range(y.numel()):
        state = [c for c in range(x.numel()) if slopes[k, c].nnz()]
        if (
            mixed[k]
            or len(state) != 1
            or state[0] in found
            or not slopes[k, state[0]].is_constant()
        ):
            continue
        factor = float(slopes[k, state[0]])
        offset = ca.simplify(ca.substitute(y[k], x, ca.SX.zeros(x.numel())))
        if factor and offset.is_constant():
            found[state[0]] = Shown(state[0], k, factor, float(offset))
    return list(found.values())


def at_samples(data: SampledData, every: int, *, spread: bool = False) -> tuple[Array, Array]:
    """Return measured outputs (k, s), gaps interpolated, and inputs (m, s) at every n-th sample of a stretch.

    The first of a stretch is its first sample; with `spread` it is another in every stretch, since
    many short ones that begin at rest would show nothing else.
    """
    outputs, inputs = [], []
    everywhere = [
        np.concatenate(rows) for rows in zip(*(s.outputs for s in data.stretches), strict=True)
    ]
    means = [float(np.nanmean(row)) if np.isfinite(row).any() else 0.0 for row in everywhere]
    for k, stretch in enumerate(data.stretches):
        at = np.arange(
            int(k * GOLDEN % 1 * min(every, len(stretch))) if spread else 0, len(stretch), every
        )
        rows = []
        for row, mean in zip(stretch.outputs, means, strict=True):
            there = np.flatnonzero(np.isfinite(row))
            rows.append(np.interp(at, there, row[there]) if there.size else np.full(at.size, mean))
        outputs.append(np.array(rows).reshape(len(rows), at.size))
        inputs.append(stretch.inputs[:, at])
    return np.concatenate(outputs, axis=1), np.concatenate(inputs, axis=1)
