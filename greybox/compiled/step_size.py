"""How finely a record is integrated and cut: substeps a sample and samples a segment, from the model along the data."""

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.initial_states import FirstStates
from greybox.compiled.transcription.method import Transcription
from greybox.compiled.vectorized import Columns
from greybox.formulation.problem import Problem
from greybox.modeling.integrators import Integrator
from greybox.modeling.realization import Dynamics

Array = NDArray[np.float64]
MOST = 64  # substeps
DRAWS, LOOKED = 17, 3  # points of the start box whose poles, and whose integration, are looked at; the declared first
SPARSE = 5  # every so manieth sample serves for the poles
SPAN = 10  # samples over which the integration is looked at
ACCURACY = 1e-4  # error over them, relative to the spread of a state: what is left is mended after the search


def pace(
    part: Problem,
    method: Transcription,
    system: Dynamics,
    first: FirstStates,
    seen: tuple[Array, Array],
    known: Callable[[Array], Array],
) -> tuple[int, int]:
    """Return substeps a sample and samples a segment: what the method says, or what the model asks for.

    That is by its poles along the data, the upper quartile of the start box, or by the error over some samples, the
    median of some points, whichever is more; and no less than what the declared values ask for.

    Parameters
    ----------
    seen : (k, s) and (m, s) arrays
        Outputs and inputs at some samples.
    known : function
        Of the declared parameters to the known initial states (n,), NaN where unknown.
    """
    step, scheme = part.data.step, method.integrator  # type: ignore[union-attr]
    if scheme.substeps is not None and method.segment is not None:
        return scheme.substeps, method.segment
    random = np.random.default_rng(0)
    advance = _advance(system, scheme) if scheme.substeps is None and system.states else None
    sparse = (seen[0][:, ::SPARSE], seen[1][:, ::SPARSE])
    counts, exact, growths = [], [], []
    for k in range(DRAWS):
        outside = {name: p.start if k == 0 else drawn(p, random) for name, p in part.parameters.items()}
        q = np.array([float(value) for value in part.local_values(outside).values()])
        p = q[: len(part.model.parameters)]
        measured, inputs = seen if k < LOOKED else sparse
        states = first.at(measured, inputs, p, known(q))
        every = SPARSE if k < LOOKED else 1
        poles = first.poles(states[:, ::every], inputs[:, ::every], p)
        if not poles.size:
            continue
        fastest = np.maximum(np.abs(poles) / scheme.reach, np.abs(poles.imag) / scheme.wave).max()
        count = _clipped(fastest * step)
        counts.append(count)
        if advance is not None and k < LOOKED:
            along = first.as_measured(states, seen[0])
            exact.append(_accurate(advance, scheme, count, along, seen[1], p, step) if count < MOST else count)
        growths.append(float(poles.real.max(axis=1).mean()))
    growth = _quantile(growths, 3 / 4)
    segment = method.segment or int(np.clip(2 / max(growth * step, 1e-12), 5, 10))
    substeps = max([1, *counts[:1], *exact[:1], _quantile(counts, 3 / 4), _quantile(exact, 1 / 2)])
    return scheme.substeps or int(substeps), segment


def drawn(parameter: Any, random: np.random.Generator) -> float:
    """Return a value from the start box of a parameter, or its fixed one."""
    if parameter.fixed:
        return parameter.start
    low, high = np.clip(parameter.box, parameter.start - 1e6, parameter.start + 1e6)
    if parameter.scale == "log":
        return float(np.exp(random.uniform(math.log(low), math.log(high))))
    return float(random.uniform(low, high))


def _advance(system: Dynamics, scheme: Integrator) -> Columns:
    """Return one step of the integrator with inputs held, of x, u and (p, h)."""
    x, u, p, h = (
        ca.SX.sym(name, size)
        for name, size in zip("xuph", (len(system.states), len(system.inputs), len(system.parameters), 1), strict=True)
    )
    after = scheme.advance(system, x, u, ca.SX(len(system.inputs), 1), p, h)
    return Columns(ca.Function("advance", [x, u, ca.vertcat(p, h)], [after], {"cse": True}), shared=(2,))


def _accurate(
    advance: Columns, scheme: Integrator, count: int, states: Array, inputs: Array, p: Array, step: float
) -> int:
    """Return the number of substeps that makes the error over SPAN samples small, from `count` that is stable."""
    with np.errstate(all="ignore"):
        coarse, fine = (_after(advance, n, states, inputs, p, step) for n in (count, 2 * count))
    there = np.isfinite(coarse).all(axis=0) & np.isfinite(fine).all(axis=0)
    if not there.any():
        return count
    coarse, fine, states = coarse[:, there], fine[:, there], states[:, there]
    spread = np.abs(fine - fine.mean(axis=1, keepdims=True)).mean(axis=1) + np.abs(fine - states).max(axis=1)
    error = (np.abs(fine - coarse).max(axis=1) / np.where(spread > 0, spread, 1.0)).max() / ACCURACY
    return count if error <= 1 else _clipped(count * error ** (1 / scheme.order))


def _after(advance: Columns, count: int, states: Array, inputs: Array, p: Array, step: float) -> Array:
    x, constants = states, np.append(p, step / count)
    for _ in range(SPAN * count):
        (x,) = advance(x, inputs, constants)
    return x


def _clipped(count: float) -> int:
    return int(np.clip(math.ceil(min(count, MOST)), 1, MOST))


def _quantile(values: list[Any], share: float) -> float:
    # np.quantile imports masked arrays, which takes longer than all of this.
    return sorted(values)[int(share * (len(values) - 1))] if values else 0.0
