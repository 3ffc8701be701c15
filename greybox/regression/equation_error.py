"""Equation error: derivatives from smoothed data, then least squares; no start is needed.

Every equation of an ODE whose states are known in time is a regression, linear in most parameters.
Variable projection (Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432) finds the few others
(delays, the time constant of a simulated state).

Source: Morelli and Klein, Aircraft System Identification, 2nd ed., chapters 5 and 11.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from greybox.compiled.record_model import longest_delay
from greybox.data.record import Record, require_time
from greybox.files.text_table import number, one_line, text_table
from greybox.formulation.input_assumptions import (
    Inputs,
    between_samples,
    described_inputs,
)
from greybox.formulation.problem import Problem
from greybox.formulation.time_criteria import OutputError, modeled_outputs
from greybox.modeling.model import Model
from greybox.modeling.parameter import Parameter
from greybox.modeling.realization import dynamics
from greybox.modeling.transfer_function import TransferFunction
from greybox.regression.linear_in_parameters import Equations, regressions
from greybox.regression.regressors import Regressors, memory, regressors
from greybox.regression.variable_projection import Projection, UsedEquation, project
from greybox.spectral.uniform_stretches import check_uniform


@dataclass(frozen=True, eq=False)
class EquationErrorEstimate:
    """The result of `equation_error`; printing it shows estimates and equations.

    Its estimate is a start of a fit, ``gb.fit(problem, starts=[result.estimate])``.

    Attributes
    ----------
    name : str
        Names of model and record.
    estimate : mapping of name to float
        The free parameters that could be estimated, within their bounds.
    bias : mapping of name to float
        Bias due to the remaining noise in the regressors, to first order; not subtracted.
    equations : tuple of UsedEquation
    left_out : tuple of str
        Equations that could not be used, and why.
    missing : mapping of name to str
        Free parameters that could not be estimated, and why.
    at_bound : tuple of str
    states : tuple of str
        Where each state comes from.
    parameters : mapping of name to Parameter
    warnings : tuple of str
    inputs : mapping of name to str
        How each input ran between its samples, in words.
    """

    name: str
    estimate: Mapping[str, float]
    bias: Mapping[str, float]
    equations: tuple[UsedEquation, ...]
    left_out: tuple[str, ...]
    missing: Mapping[str, str]
    at_bound: tuple[str, ...]
    states: tuple[str, ...]
    parameters: Mapping[str, Parameter]
    warnings: tuple[str, ...]
    inputs: Mapping[str, str]

    def __repr__(self) -> str:
        return one_line(self, self.name, f"estimates of {', '.join(self.estimate) or 'nothing'}")

    def __str__(self) -> str:
        rows = []
        for name, value in self.estimate.items():
            p = self.parameters[name]
            note = "AT BOUND" if name in self.at_bound else ""
            rows.append([name, number(value), number(self.bias[name], 2), p.unit, note, p.about])
        header = ["parameter", "estimate", "bias by noise", "unit", "", "meaning"]
        lines = text_table(header, rows, left=(0, 3, 4, 5)).splitlines()
        lines += [f"not estimated: {name}, {why}" for name, why in self.missing.items()]

        rows = []
        for e in self.equations:
            band = "all" if math.isinf(e.band) else number(e.band, 3)
            cells = [f"{e.r_squared:.4f}", str(e.rows), band, number(e.residual, 3)]
            rows.append([e.left, " ".join(e.parameters), *cells])
        header = ["equation", "for", "R²", "rows", "band, Hz", "residual"]
        lines += ["", *text_table(header, rows, (0, 1)).splitlines()]
        lines += [f"left out: {text}" for text in self.left_out]
        lines += ["", *(f"state {text}" for text in self.states)]
        lines += [f"input {name} {text}" for name, text in self.inputs.items()]
        lines += ["", *(f"warning: {text}" for text in self.warnings)]
        lines += [
            "Noise in the regressors biases the estimate by about 'bias by noise', which is not",
            "subtracted. Use the estimate as a start for gb.fit, which gives standard errors.",
        ]
        indented = ("  " + line if line else line for line in lines)
        return "\n".join([f"{self.name}: equation error", "", *indented])


def equation_error(
    model: Model,
    record: Record,
    *,
    fixed: Mapping[str, float] | None = None,
    free: Sequence[str] = (),
    inputs: Inputs = "record",
) -> EquationErrorEstimate:
    """Estimate the parameters of an ODE from measured states, by least squares per equation.

    A state is known if the record has a signal of its name or an output that equals it (up to
    constants), if it is the derivative of a known state (``theta' = q``), or if it follows from a
    stable linear equation driven by known signals (a rotor lag), which is then simulated. Equations
    with other states are left out. All terms of an equation pass the same low-pass filter, so that
    smoothing affects both sides alike. Inputs that are not held are interpolated between samples by
    cubic splines. A transfer function can be used only if it has one pole.

    Noise in the states biases the estimate. `EquationErrorEstimate.bias` estimates this bias, but
    not the part that arises if a controller feeds the noise back to an input. An equation with a
    state that is simulated from its own target (`nu` from `r` in `greybox.models.yaw.YawStates`)
    may at high noise explain the target by itself: its parameters then run to their bounds.

    Parameters
    ----------
    model : Model
        Its inputs, states and outputs have the names of signals in the record.
    record : Record
        Uniform but for gaps, with every input; NaN marks missing samples.
    fixed : mapping of name to value
        Parameters held constant.
    free : sequence of str
        Parameters to estimate although the model declares them fixed.
    inputs : "record", "linear" or "held"
        How inputs run between their samples, as in `OutputError`: by default as the record says.

    Raises
    ------
    ValueError
        For an unknown name, a missing input, constant signals, or non-uniform sampling; if nothing
        is free or determined; or if no equation can be used.
    """
    if not isinstance(record, Record):
        raise TypeError(f"record is {record!r:.60}: give a Record, as gb.prepare returns it.")
    require_time(record, "equation_error")
    criterion = _NoOutputs(inputs=inputs)
    problem = Problem(model, record, criterion, fixed=fixed or {}, free=free)
    parameters = problem.parameters
    constants = {n: p.start for n, p in parameters.items() if p.fixed}
    unknown = {n: p for n, p in parameters.items() if not p.fixed}
    if not unknown:
        raise ValueError(f"{model.label} has no free parameter here: name some with free=(...).")

    system = dynamics(model)
    for piece in record.pieces:
        check_uniform(piece.time, record)
    start = np.array([p.start for p in unknown.values()])
    equations = regressions(system, record.signals, constants, start)
    _require_equations(model, equations, record)
    longest_delays = longest_delay(problem, system)
    between = dict(zip(system.inputs, between_samples(inputs, system.inputs, record), strict=True))

    # The smoothing does not depend on the parameters, so it is done once.
    data = regressors(equations, record, start, longest_delays, between)
    projection = project(data, unknown, start)
    # Lags that turn out slower than at their start need more rows to forget their initial values.
    # With a memory 10 % longer than assumed, they hold 1.5 % of these instead of 1 %.
    slower = projection.vector
    if memory(equations, slower) > 1.1 * memory(equations, start):
        cutoffs = data.cutoffs
        shorter = regressors(equations, record, slower, longest_delays, between, cutoffs=cutoffs)
        if shorter.rows(slower).target.size:  # else the record is too short for that
            data = shorter
            start = slower
            projection = project(data, unknown, start)

    again = partial(regressors, equations, p=start, latest=longest_delays, cutoffs=data.cutoffs)
    bias = _bias(data, projection, record, again)
    name = f"{model.label}, {record.name or 'record'}"
    texts = described_inputs(inputs, system.inputs, record)
    return _result(name, data, projection, bias, parameters, texts)


class _NoOutputs(OutputError):  # noqa: N818  (no exception)
    """A criterion that compares no outputs: regressions may do with states alone."""

    def compared(self, model: Model, record: Record) -> tuple[str, ...]:
        modeled_outputs(model, record.signals, model.output_names, "record")  # checks the inputs
        return ()


def _require_equations(model: Model, equations: Equations, record: Record) -> None:
    if equations.equations:
        return
    if isinstance(model, TransferFunction):
        raise ValueError(
            f"the equation of {model.label} needs derivatives of {model.output!r} that the record "
            "does not have: declare it as a StateSpace whose states are measured, or fit its "
            "frequency response, see gb.regression.levy."
        )
    reasons = (
        "; ".join(equations.left_out)
        or "none contains a free parameter and only signals of the record"
    )
    raise ValueError(
        f"no equation of {model.label} can be used ({reasons}); the record has "
        f"{', '.join(record.signals)}: add the missing states under their names."
    )


def _bias(
    data: Regressors, projection: Projection, record: Record, again: Callable[..., Regressors]
) -> dict[str, float]:
    """Return how far noise like that of the signals moves the estimate, by adding it once more.

    Source: simulation and extrapolation, Cook and Stefanski, J. Amer. Statist. Assoc. 89 (1994)
    1314-1328, here with linear extrapolation and one Gauss-Newton step.
    """
    if not data.noise:
        return dict.fromkeys(projection.names, 0.0)
    # The same noise for every call: an estimate must not change from run to run.
    random = np.random.default_rng(0)
    steps = []
    # One pair averages well enough over a long record.
    for _ in range(2 if len(record) < 20000 else 1):
        noise = {n: s * random.normal(size=len(record)) for n, s in data.noise.items()}
        # With both signs, effects that are odd in the noise cancel.
        for sign in (1, -1):
            added = {n: record[n] + sign * e for n, e in noise.items()}
            noisy = replace(record, signals={**record.signals, **added})
            steps.append(projection.step(again(record=noisy, between=data.between)))
    return dict(zip(projection.names, np.mean(steps, axis=0), strict=True))


def _result(
    name: str,
    data: Regressors,
    projection: Projection,
    bias: Mapping[str, float],
    parameters: Mapping[str, Parameter],
    inputs: Mapping[str, str],
) -> EquationErrorEstimate:
    unknown = [n for n, p in parameters.items() if not p.fixed]
    missing = {n: _why(n, projection) for n in unknown if n not in projection.names}
    used = projection.equations
    return EquationErrorEstimate(
        name=name,
        estimate=dict(zip(projection.names, projection.values.tolist(), strict=True)),
        bias={n: float(b) for n, b in bias.items()},
        equations=tuple(e for e in used if e.rows),
        left_out=(
            *data.equations.left_out,
            *(f"{e.left} (no stretch is long enough)" for e in used if not e.rows),
        ),
        missing=missing,
        at_bound=projection.at_bound,
        states=tuple(str(state) for state in data.equations.states),
        parameters=dict(parameters),
        warnings=tuple(_warnings(used, projection)),
        inputs=inputs,
    )


def _why(name: str, projection: Projection) -> str:
    partners = next((group for group in projection.undetermined if name in group), ())
    if len(partners) > 1:
        return f"only a combination of {', '.join(partners)} is determined: fix one of them"
    if partners:
        return "it has no effect in these data"
    return "it is in no equation that can be used"


def _warnings(used: Sequence[UsedEquation], projection: Projection) -> list[str]:
    bounded = [f"{n} ended at its bound." for n in projection.at_bound]
    unexplained = [
        f"only {100 * max(e.r_squared, 0):.0f} % of the variance of {e.left} is explained: there "
        "is noise, or the model is incomplete."
        for e in used
        if e.rows and e.r_squared < 0.5
    ]
    return [*bounded, *unexplained]
