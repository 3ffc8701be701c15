"""One sample of a record: delayed inputs, residuals, innovations, and the step to the next.

This is the one function that simulation, linearization, transcription and prediction share;
`SampleStep.folded` repeats it over samples for CasADi, `SampleStep.simulate` and
`greybox.engine.compiled.segments` do so in numpy.
"""

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.sampled_data import input_over_step
from greybox.engine.compiled.vectorized import Columns
from greybox.modeling.cached_property import cached_property
from greybox.modeling.formulation.signal_bias import bias_name
from greybox.modeling.integrators import Integrator, repeated, substep_function
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.realization import Dynamics
from greybox.modeling.symbolic_reading import as_column, input_symbols
from greybox.modeling.traced_once import once

# Samples of one call: of its overhead of 12 µs a sample bears a tenth of a microsecond.
RUN = 100


@frozen
class SampleStep:
    """One sample in CasADi, of states x (n,), all parameters q and data d.

    Attributes
    ----------
    function : casadi.Function
        (x, q, d) -> x one sample later, residuals of the measured outputs (zero where missing),
        simulated outputs.
    measurement : casadi.Function
        (x, q, d) -> x corrected by the innovations, mean of the delayed inputs over the step and
        their change, residuals, simulated outputs.
    substep : casadi.Function
        (x, u, slope, p, h) -> x one substep later.
    substeps : int
        Substeps of a sample.
    system : Dynamics
    width : int
        Length of d: whole samples of delay (m), windows of the inputs (3 m), outputs (k), present
        (k), step.
    """

    function: ca.Function
    measurement: ca.Function
    substep: ca.Function
    substeps: int
    system: Dynamics
    width: int

    @property
    def repeats(self) -> bool:
        """Whether the function calls one explicit substep repeatedly instead of copying it."""
        return self.substep.is_a("SXFunction") and not self.function.is_a("SXFunction")

    def symbols(self) -> list[Any]:
        """Return x, q and d as symbols of the kind that the function takes."""
        return input_symbols(self.function)

    @cached_property
    def substep_of_columns(self) -> Columns:
        """Return the substep at many states and inputs, with the same parameters."""
        return Columns(self.substep, (3,))

    @cached_property
    def built(self) -> dict[Any, Any]:
        """Functions of many columns and of many samples by key, shared by all segments."""
        return {}

    @one_thread_at_a_time
    def folded(self, samples: int) -> ca.Function:
        """Return (x, q, D) -> states (n, samples) after each sample, residuals (k, samples)."""
        if samples not in self.built:
            step = self.function
            if step.is_a("SXFunction"):  # without the outputs, and what only they need
                symbols = self.symbols()
                step = ca.Function("one", symbols, list(self.function(*symbols)[:2]))
            x, q, _ = self.function.mx_in()
            D = ca.MX.sym("D", self.width, samples)
            states, residuals, *_ = step.mapaccum("fold", samples)(x, q, D)
            self.built[samples] = ca.Function("folded", [x, q, D], [states, residuals])

        return self.built[samples]

    def simulate(self, x: Array, q: Array, data: Array) -> Array:
        """Return the states (m + 1, n) of m samples from a state (n,); data (m, width)."""
        m = len(data)
        q = np.ascontiguousarray(q, dtype=float)
        # A call takes RUN samples.
        size = math.ceil(m / RUN) * RUN
        states = np.empty((size + 1, len(x)))
        states[0] = x
        last = np.pad(data[size - RUN :], ((0, size - m), (0, 0)), "edge")

        # CasADi reads and writes these arrays in place: with a conversion of 6000 samples a call
        # takes seven times as long.
        function: Any = self.folded(RUN)
        buffer, evaluate = function.buffer()
        buffer.set_arg(1, q.data)
        for first in range(0, size, RUN):
            run = data[first : first + RUN] if first + RUN < size else last
            buffer.set_arg(0, states[first].data)
            buffer.set_arg(2, run.data)
            buffer.set_res(0, states[first + 1 : first + RUN + 1].data)
            evaluate()

        return states[: m + 1]


def sample_step(
    system: Dynamics,
    held: Sequence[bool],
    names: tuple[str, ...],
    integrator: Integrator,
    substeps: int,
    *,
    biases: tuple[str, ...] = (),
    corrects_states: bool = False,
) -> SampleStep:
    """Compile one sample of the parameters `names`: the model's, then the criterion's.

    `held` (m,) says which inputs keep their values until the next sample; the others are
    interpolated. `biases` are the outputs and inputs with an unknown constant error;
    `corrects_states` says whether residuals correct the states.
    """
    measurement = _measurement(system, tuple(held), biases, corrects_states, names)
    substep = substep_function(system, integrator)
    # Copies of many operations take longer to compile than calls of one function to evaluate: a
    # chain of four masses, with 1400 in four substeps, takes twice the time.
    is_copied = substep.is_a("SXFunction") and substep.n_instructions() * substeps <= 1000
    symbols: Any = measurement.sx_in() if is_copied else measurement.mx_in()
    x, q, d = symbols
    corrected, mean, change, residual, simulated = measurement(x, q, d)
    # The derivatives of a called function have no zeros: they fill a product of large matrices.
    begin = corrected if corrects_states else x
    p = q[: len(system.parameters)]
    end = repeated(substep, substeps, begin, mean, change, p, d[d.numel() - 1])
    # Outputs and derivatives of many models have terms in common.
    function = ca.Function("sample", [x, q, d], [end, residual, simulated], {"cse": True})
    return SampleStep(function, measurement, substep, substeps, system, d.numel())


@once
def _measurement(
    system: Dynamics,
    held: Sequence[bool],
    biases: tuple[str, ...],
    corrects: bool,
    names: tuple[str, ...],
) -> ca.Function:
    """Return the quantities before the step: delayed inputs, residuals, corrected states."""
    n, m, k = len(system.states), len(system.inputs), len(system.outputs)
    x, q = ca.SX.sym("x", n), ca.SX.sym("q", len(names))
    whole, window = ca.SX.sym("whole", m), ca.SX.sym("window", 3 * m)
    measured, present, step = ca.SX.sym("y", k), ca.SX.sym("present", k), ca.SX.sym("step")
    p = q[: len(system.parameters)]
    bias = {name: q[names.index(bias_name(name))] for name in biases}

    input_biases = as_column(bias.get(name, 0) for name in system.inputs)
    output_biases = as_column(bias.get(name, 0) for name in system.outputs)

    delay = system.delay(p)
    rows = []
    for i in range(m):
        # The data are shifted by the whole samples of the delay: the formula sees the rest.
        fraction = ca.SX(0) if delay[i].is_zero() else delay[i] / step - whole[i]
        rows.append(ca.horzcat(*input_over_step(window[3 * i : 3 * i + 3], fraction, held[i])))

    mean, change, now = ca.horzsplit(ca.vertcat(ca.SX(0, 3), *rows))
    mean = mean - input_biases
    now = now - input_biases
    simulated = system.output(x, now, p) + output_biases
    # The residual is zero where nothing was measured: no correction, and no share in the cost.
    residual = present * (measured - simulated)

    corrected = ca.SX(x)  # a copy: assignment to its entries below would change the symbol
    for i, state in enumerate(system.states if corrects else ()):
        for j, output in enumerate(system.outputs):
            gain = f"K_{state}_{output}"
            if gain in names:
                corrected[i] += q[names.index(gain)] * residual[j]

    data = ca.vertcat(whole, window, measured, present, step)
    return ca.Function("measurement", [x, q, data], [corrected, mean, change, residual, simulated])
