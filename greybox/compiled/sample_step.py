"""What happens at one sample of a record: delayed inputs, residuals, innovations, and the step to the next sample."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.sampled_data import input_over_step
from greybox.formulation.time_criteria import TimeCriterion
from greybox.modeling.integrators import Integrator, step_function
from greybox.modeling.realization import Dynamics

Array = NDArray[np.float64]
RUN = 100  # samples that one call follows


@dataclass(frozen=True, eq=False)
class SampleStep:
    """One sample in CasADi, of states x (n,), all parameters q and data d.

    Attributes
    ----------
    function : casadi.Function
        (x, q, d) -> x one sample later, residuals of the measured outputs (zero where missing), simulated outputs.
    before : casadi.Function
        (x, q, d) -> x corrected by the innovations, mean of the delayed inputs over the step and their change,
        residuals, simulated outputs.
    system : Dynamics
    width : int
        Length of d: whole samples of delay (m), windows of the inputs (3 m), outputs (k), present (k), step.
    """

    function: ca.Function
    before: ca.Function
    system: Dynamics
    width: int

    @cached_property
    def _run(self) -> ca.Function:
        """(x, q, d of RUN samples) -> x after each of them, residuals of each."""
        x, q, d = (ca.SX.sym(name, self.function.numel_in(k)) for k, name in enumerate("xqd"))
        one = ca.Function("one", [x, q, d], list(self.function(x, q, d)[:2]), {"cse": True})
        first, Q, D = ca.MX.sym("x", x.numel()), ca.MX.sym("q", q.numel()), ca.MX.sym("d", d.numel(), RUN)
        found: Any = one.mapaccum("run", RUN)(first, Q, D)
        return ca.Function("run", [first, Q, D], list(found))

    def follow(self, x: Array, q: Array, data: Array) -> tuple[Array, Array]:
        """Return the states (m + 1, n) and residuals (m, k) of m samples from a first state (n,); data (m, width)."""
        m, q = len(data), np.ascontiguousarray(q, dtype=float)
        size = -(-m // RUN) * RUN
        states, residuals = np.empty((size + 1, len(x))), np.empty((size, self.function.numel_out(1)))
        states[0] = x
        last = data[size - RUN :]
        last = np.concatenate([last, np.repeat(data[-1:], size - m, axis=0)])  # a call takes RUN samples
        run: Any = self._run
        buffer, evaluate = run.buffer()
        buffer.set_arg(1, q.data)
        for at in range(0, size, RUN):
            some = data[at : at + RUN] if at + RUN < size else last
            buffer.set_arg(0, states[at].data)
            buffer.set_arg(2, some.data)
            buffer.set_res(0, states[at + 1 : at + RUN + 1].data)
            buffer.set_res(1, residuals[at : at + RUN].data)
            evaluate()
        return states[: m + 1], residuals[:m]


def sample_step(
    system: Dynamics,
    criterion: TimeCriterion,
    outputs: tuple[str, ...],
    names: tuple[str, ...],
    integrator: Integrator,
    substeps: int,
) -> SampleStep:
    """Compile one sample of the declared parameters `names`: the model's first, then the criterion's."""
    before = _before(system, criterion, outputs, names)
    x, q, d = (ca.SX.sym(name, before.numel_in(k)) for k, name in enumerate("xqd"))
    corrected, mean, change, residual, simulated = before(x, q, d)
    step = step_function(system, integrator, substeps)
    after = step(corrected, mean, change, q[: len(system.parameters)], d[d.numel() - 1])
    function = ca.Function("sample", [x, q, d], [after, residual, simulated], {"cse": True})
    return SampleStep(function, before, system, d.numel())


def _before(
    system: Dynamics, criterion: TimeCriterion, outputs: tuple[str, ...], names: tuple[str, ...]
) -> ca.Function:
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
    if criterion.corrects_states:
        for i, state in enumerate(system.states):
            for j, output in enumerate(outputs):
                if f"K_{state}_{output}" in names:
                    corrected[i] += q[names.index(f"K_{state}_{output}")] * residual[j]
    data = ca.vertcat(whole, window, measured, present, step)
    return ca.Function("before", [x, q, data], [corrected, mean, change, residual, simulated])
