"""Initial states at the nodes: as the outputs show them, or else where the model is finite.

A state begins as measured where an output shows it, or at the mean of an output that is mostly
noise, and else where the model declares, by default at zero. A root, a logarithm or a division may
exclude zero (the level of a tank, an airspeed, a temperature). Then sizes over many decades are
tried for the states that no output shows; the model must come closest to the measured outputs.
"""

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, BoolArray, ComplexArray, IntArray, positive_or_one
from greybox.engine.compiled.sampled_data import SampledData
from greybox.engine.compiled.vectorized import Columns
from greybox.modeling.realization import Dynamics
from greybox.modeling.symbolic_reading import dense_jacobian
from greybox.statistics.noise_ratio import SMOOTH, noise_ratio

# Multiples of the golden ratio modulo one are spread more evenly than those of any other number.
GOLDEN = (5**0.5 - 1) / 2
SIZES = (1.0, 0.1, 10.0, 0.01, 100.0, 1e-3, 1e3, 1e4, 1e5, -1.0, -0.1, -10.0, -100.0)


class InitialStates:
    """The states of a model at some samples, for the outputs that it has."""

    def __init__(self, system: Dynamics) -> None:
        """Compile the model and its derivatives."""
        self._n = len(system.states)
        self._driven = len((system.undelayed or system).states)
        x, u, p = system.symbols
        y = system.output(x, u, p)
        f = system.derivative(x, u, p)
        slopes = ca.vertcat(ca.vec(dense_jacobian(f, x)), ca.vec(dense_jacobian(y, x)))
        self._model = Columns(ca.Function("first", [x, u, p], [f, y, slopes]), shared=(2,))
        self._starts = system.starts
        self._links = _links(y, x, ca.vertcat(u, p))

    def at(self, measured: Array, inputs: Array, p: Array, known: Array) -> Array:
        """Return states (n, s) for outputs (k, s) without gaps, inputs (m, s) and parameters p.

        `known` (n,) are known initial states, else NaN. Zeros where the model is finite nowhere.
        """
        starts = np.repeat(self._starts(p).full(), inputs.shape[1], axis=1)
        measured_states = self.as_measured(starts, measured)
        hidden = np.ones(self._n, dtype=bool)
        hidden[list(self._links)] = False
        is_known = hidden & np.isfinite(known)
        measured_states[is_known] = known[is_known, None]
        finite, _ = self._judged(measured_states, measured, inputs, p)
        if finite.all():
            return measured_states
        # Without this scan the two models of tanks are never found (8 of 12 runs with it).
        unknown = np.flatnonzero(hidden & ~is_known)
        states = self._sized(measured_states, unknown, measured, inputs, p)
        # A few samples outside the domain, as noise below an empty tank, must not spoil a start.
        return _mended(states, self._judged(states, measured, inputs, p)[0])

    def as_measured(self, states: Array, measured: Array) -> Array:
        """Return the states (n, s); those that outputs show are as measured."""
        states = states.copy()
        for state, (output, factor, offset) in self._links.items():
            states[state] = (measured[output] - offset) / factor
        return states

    def poles(self, states: Array, inputs: Array, p: Array) -> ComplexArray:
        """Return the finite poles (s, n) of the linearizations at states (n, s).

        The poles of delays, which no integrator follows, are left out.
        """
        matrices = self._model(states, inputs, p)[2][: self._n**2].T.reshape(
            inputs.shape[1], self._n, self._n
        )[:, : self._driven, : self._driven]
        return np.linalg.eigvals(matrices[np.isfinite(matrices).all(axis=(1, 2))]).astype(complex)

    def _sized(
        self, states: Array, hidden: IntArray, measured: Array, inputs: Array, p: Array
    ) -> Array:
        """Return the states with the hidden ones scaled best: first all together, then each."""

        def score(trial: Array) -> tuple[int, float]:
            finite, missed = self._judged(trial, measured, inputs, p)
            return int((~finite).sum()), float(missed[finite].sum())

        best = states
        least = score(states)
        # All states together first: one alone may leave the model undefined because of another.
        # Then each by itself, in two sweeps.
        for group in [hidden, *([[k] for k in hidden] * 2)]:
            for size in (0.0, *SIZES):
                trial = best.copy()
                trial[group] = size
                trial_score = score(trial)
                if trial_score < least:
                    best, least = trial, trial_score

        return best

    def _judged(
        self, states: Array, measured: Array, inputs: Array, p: Array
    ) -> tuple[BoolArray, Array]:
        """Return where the model is finite (s,), and its squared output errors (s,).

        The errors are in units of the largest measured value.
        """
        f, y, slopes = self._model(states, inputs, p)
        # Derivatives count too: a root is finite at zero, its slope is not.
        finite = np.asarray(np.isfinite(np.vstack([f, y, slopes])).all(axis=0))
        scale = np.abs(measured).max(axis=1, initial=0.0, keepdims=True)
        with np.errstate(all="ignore"):
            return finite, (((y - measured) / positive_or_one(scale)) ** 2).sum(axis=0)


def _mended(states: Array, finite: BoolArray) -> Array:
    """Give samples where the model is not finite (s,) the states (n, s) of the nearest finite one.

    Zeros where it is finite nowhere.
    """
    if not finite.any():
        return np.zeros_like(states)
    usable = np.flatnonzero(finite)
    return states[:, usable[np.abs(np.arange(finite.size)[:, None] - usable).argmin(axis=1)]]


def _links(y: ca.SX, x: ca.SX, others: ca.SX) -> dict[int, tuple[int, float, float]]:
    """Return the states that outputs show directly: the first output = factor · state + offset."""
    links: dict[int, tuple[int, float, float]] = {}
    slopes = ca.jacobian(y, x)
    mixed = ca.which_depends(y, others, 1, True) if others.numel() else [False] * y.numel()
    for k in range(y.numel()):
        row = slopes[k, :]
        if mixed[k] or row.nnz() != 1 or not row.is_constant():
            continue
        (state,) = row.sparsity().get_triplet()[1]
        factor = float(row[state])
        offset = ca.substitute(y[k], x, ca.SX.zeros(x.numel()))
        if factor and offset.is_constant():
            links.setdefault(state, (k, factor, float(offset)))

    return links


def at_samples(data: SampledData, every: int, *, spread: bool = False) -> tuple[Array, Array]:
    """Return measured outputs (k, s) and inputs (m, s) at every n-th sample of a stretch.

    Gaps of the outputs are interpolated. An output that is mostly noise has its mean everywhere.

    They begin with the first sample of a stretch. With `spread` they begin with another sample in
    every stretch: otherwise many short stretches that begin at rest would show nothing but rest.
    """
    places = []
    for k, stretch in enumerate(data.stretches):
        first = int(k * GOLDEN % 1 * min(every, len(stretch))) if spread else 0
        places.append(np.arange(first, len(stretch), every))

    outputs = []
    for rows in zip(*(stretch.outputs for stretch in data.stretches), strict=True):
        values = np.concatenate(rows)
        mean = float(np.nanmean(values)) if np.isfinite(values).any() else 0.0
        is_noise = noise_ratio(rows).ratio > SMOOTH
        output = []
        for row, at in zip(rows, places, strict=True):
            present = np.flatnonzero(np.isfinite(row))
            if is_noise or not present.size:
                output.append(np.full(at.size, mean))
            else:
                output.append(np.interp(at, present, row[present]))
        outputs.append(np.concatenate(output))

    pairs = zip(data.stretches, places, strict=True)
    return np.array(outputs), np.hstack([stretch.inputs[:, at] for stretch, at in pairs])
