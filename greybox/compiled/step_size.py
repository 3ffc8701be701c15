"""Substeps of a sample and samples of a segment.

The rule for substeps is that of `greybox.modeling.step_size`. Here it is asked with the model along
the measured data, at the declared parameters and at others drawn from the start boxes, where the
search will go.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.initial_states import InitialStates
from greybox.compiled.transcription.method import Transcription
from greybox.compiled.vectorized import Columns
from greybox.files.arrays import Array
from greybox.formulation.problem import Problem
from greybox.modeling.integrators import Integrator
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.realization import Dynamics
from greybox.modeling.step_size import (
    MOST_SUBSTEPS,
    accurate_substeps,
    relative_change,
    stable_substeps,
)

# Parameter vectors, the declared one first: with 17 a quartile is one of them, and a few odd draws
# do not move it.
DRAWS = 17
INTEGRATED = 3  # of these, along which the model is also integrated: the fewest that have a median
EVERY = 5  # every n-th sample serves for the poles: an eigenvalue problem each, and neighbors have nearly the same
# Samples. On the unstable tilt plant segments of 5 to 20 samples converged from 14 of 14 random
# starts, 50 failed.
SHORTEST_SEGMENT = 5
LONGEST_SEGMENT = 10
# Integration error over a longest segment, relative to the spread of a state, for the first substeps.
LOCAL_ACCURACY = 1e-4
SEGMENT_GROWTH = 2.0  # an unstable mode may grow by exp(2), sevenfold, over a segment


def substeps_and_segment(
    problem: Problem,
    drawn: Array,
    method: Transcription,
    system: Dynamics,
    initial_states: InitialStates,
    samples: tuple[Array, Array],
    known_initial: Callable[[Array], Array],
) -> tuple[int, int]:
    """Return substeps per sample and samples per segment, those of the method or those that the model needs.

    The poles along the data need the upper quartile of substeps over the draws, accuracy needs the
    median over some of them: the larger number, and no less than the declared parameters need.

    Parameters
    ----------
    drawn : (draws, declared) array
        See `drawn_parameters`.
    samples : (k, s) and (m, s) arrays
        Measured outputs and inputs at some samples.
    known_initial : function
        Of the declared parameters to the known initial states (n,), NaN where unknown.
    """
    step = problem.data.step  # type: ignore[union-attr]
    integrator = method.scheme
    if integrator.substeps is not None and method.segment is not None:
        return integrator.substeps, method.segment

    strategies = method.strategies
    chooses = integrator.substeps is None and strategies.accurate_substeps and system.states
    judge = AccuracyJudge.of(system, integrator) if chooses else None
    outputs, inputs = samples
    stable: list[int] = []
    accurate: list[int] = []
    growth_rates: list[float] = []
    for k, declared in enumerate(drawn):
        integrated = k < INTEGRATED
        stride = 1 if integrated else EVERY
        p = declared[: len(problem.model.parameters)]
        states = initial_states.at(
            outputs[:, ::stride], inputs[:, ::stride], p, known_initial(declared)
        )

        poles = initial_states.poles(states[:, :: EVERY // stride], inputs[:, ::EVERY], p)
        if not poles.size:
            continue
        count = stable_substeps(poles, step, reach=integrator.reach, wave=integrator.wave)
        stable.append(count)
        growth_rates.append(float(poles.real.max(axis=1).mean()))

        if judge is not None and integrated:
            measured = initial_states.as_measured(states, outputs)
            accurate.append(judge.substeps(count, measured, inputs, p, step))

    growth_rate = _quantile(growth_rates, 3 / 4)
    longest = SEGMENT_GROWTH / max(growth_rate * step, 1e-12)
    segment = method.segment or int(np.clip(longest, SHORTEST_SEGMENT, LONGEST_SEGMENT))
    substeps = max(
        [1, *stable[:1], *accurate[:1], _quantile(stable, 3 / 4), _quantile(accurate, 1 / 2)]
    )
    return integrator.substeps or int(substeps), segment


def drawn_parameters(problem: Problem) -> Array:
    """Return vectors of all declared parameters, the model's first: at the starts, then drawn from the start boxes."""
    random = np.random.default_rng(0)
    drawn = []
    for k in range(DRAWS):
        outside = {
            name: p.start if k == 0 or p.fixed else p.draw(random)
            for name, p in problem.parameters.items()
        }
        drawn.append([float(value) for value in problem.local_values(outside).values()])
    return np.array(drawn).reshape(DRAWS, -1)


@dataclass(frozen=True, eq=False)
class AccuracyJudge:
    """One step of the integrator with the inputs held, evaluated at many samples at once."""

    one_step: Columns
    order: int

    @classmethod
    @one_thread_at_a_time
    def of(cls, system: Dynamics, integrator: Integrator) -> "AccuracyJudge":
        """Compile the step as a function of x, u and (p, h)."""
        kind: Any = ca.MX if integrator.implicit else ca.SX
        x = kind.sym("x", len(system.states))
        u = kind.sym("u", len(system.inputs))
        p = kind.sym("p", len(system.parameters))
        h = kind.sym("h")
        held = kind(len(system.inputs), 1)
        end = integrator.advance(system, x, u, held, p, h)
        constants = kind.sym("constants", len(system.parameters) + 1)
        named = [x, u, constants[:-1], constants[-1]]
        step = ca.Function(
            "advance", [x, u, constants], [ca.Function("one", [x, u, p, h], [end])(*named)]
        )
        return cls(
            Columns(step, shared=(2,)),
            integrator.order,
        )

    def substeps(self, count: int, states: Array, inputs: Array, p: Array, step: float) -> int:
        """Return the substeps, at least `count`, that make the error over a longest segment small."""
        if count >= MOST_SUBSTEPS:
            return count
        with np.errstate(all="ignore"):
            coarse = self._after_segment(count, states, inputs, p, step)
            fine = self._after_segment(2 * count, states, inputs, p, step)
        finite = np.isfinite(coarse).all(axis=0) & np.isfinite(fine).all(axis=0)
        if not finite.any():
            return count

        coarse = coarse[:, finite]
        fine = fine[:, finite]
        # A state that is nearly constant over the data still counts by how far it moves within a
        # segment.
        spread = np.abs(fine - fine.mean(axis=1, keepdims=True)).mean(axis=1)
        moved = np.abs(fine - states[:, finite]).max(axis=1)
        error = relative_change(fine - coarse, spread + moved)
        return accurate_substeps(count, error, LOCAL_ACCURACY, self.order)

    def _after_segment(
        self, count: int, states: Array, inputs: Array, p: Array, step: float
    ) -> Array:
        x = states
        constants = np.append(p, step / count)
        for _ in range(LONGEST_SEGMENT * count):
            (x,) = self.one_step(x, inputs, constants)
        return x


def _quantile(values: list[int] | list[float], share: float) -> float:
    # np.quantile imports masked arrays, which takes longer than all of this.
    return sorted(values)[math.floor(share * (len(values) - 1))] if values else 0.0
