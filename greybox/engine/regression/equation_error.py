"""Equation error: derivatives from smoothed data, then least squares; no start is needed.

Every equation of an ODE whose states are known in time is a regression on the parameters that enter
it linearly. Others, such as delays, are held at their starts.

Source: Morelli and Klein, Aircraft System Identification, 2nd ed., chapters 5 and 11.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from greybox.data.clock import runs_between_holes
from greybox.data.files.argument_checks import require_kind
from greybox.data.files.arrays import Array, sum_of_squares
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table, titled
from greybox.data.record import Record, require_time, unrounded
from greybox.data.spectral.uniform_stretches import check_uniform
from greybox.engine.regression.least_squares import undetermined
from greybox.engine.regression.linear_in_parameters import Equations, regressions
from greybox.engine.regression.regressors import regressors
from greybox.modeling.formulation.input_assumptions import Inputs, between_samples, described_inputs
from greybox.modeling.formulation.modeled_outputs import modeled_outputs
from greybox.modeling.formulation.output_error import OutputError
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.model import Model
from greybox.modeling.parameter import Parameter, Parameters, lower_and_upper, start_values
from greybox.modeling.realization import dynamics
from greybox.modeling.transfer_function import TransferFunction


@frozen
class UsedEquation:
    """One regression: left side, R², number of rows, band of its terms (Hz), and residual (rms).

    It has 0 rows if no stretch was long enough.
    """

    left: str
    parameters: tuple[str, ...]
    r_squared: float
    rows: int
    band: float
    residual: float


@public
@frozen
class EquationErrorEstimate(Printed):
    """The result of `equation_error`; printing it shows estimates and equations.

    Its estimate is a start of a fit, ``gb.fit(problem, starts=[result.estimate])``.

    Attributes
    ----------
    name : str
        Names of model and record.
    estimate : mapping of name to float
        The free parameters that could be estimated, within their bounds.
    equations : tuple of UsedEquation
    left_out : tuple of str
        Equations that could not be used, and why.
    missing : mapping of name to str
        Free parameters that were not estimated, and why.
    at_bound : tuple of str
    states : tuple of str
        Where each state comes from.
    parameters : mapping of name to Parameter
    warnings : tuple of str
    inputs : mapping of name to str
        How each input ran between its samples, in words.
    """

    name: str
    estimate: Values
    equations: tuple[UsedEquation, ...]
    left_out: tuple[str, ...]
    missing: Mapping[str, str]
    at_bound: tuple[str, ...]
    states: tuple[str, ...]
    parameters: Parameters
    warnings: tuple[str, ...]
    inputs: Mapping[str, str]

    def __str__(self) -> str:
        rows = []
        for name, value in self.estimate.items():
            p = self.parameters[name]
            note = "AT BOUND" if name in self.at_bound else ""
            rows.append([name, number(value), p.unit, note, p.about])
        header = ["parameter", "estimate", "unit", "", "meaning"]
        lines = [text_table(header, rows, left=(0, 2, 3, 4))]
        lines += [f"not estimated: {name}, {why}" for name, why in self.missing.items()]

        rows = []
        for e in self.equations:
            band = "all" if math.isinf(e.band) else number(e.band, 3)
            cells = [f"{e.r_squared:.4f}", str(e.rows), band, number(e.residual, 3)]
            rows.append([e.left, " ".join(e.parameters), *cells])
        header = ["equation", "for", "R²", "rows", "band, Hz", "residual"]
        lines += ["", text_table(header, rows, (0, 1))]
        lines += [f"left out: {text}" for text in self.left_out]
        lines += ["", *(f"state {text}" for text in self.states)]
        lines += [f"input {name} {text}" for name, text in self.inputs.items()]
        lines += ["", *(f"warning: {text}" for text in self.warnings)]
        lines += [
            "Noise in the regressors biases the estimate. Use it as a start for gb.fit, which",
            "gives standard errors.",
        ]
        return titled(f"{self.name}: equation error", lines)


@public
def equation_error(
    model: Model,
    record: Record,
    *,
    fixed: Values | None = None,
    free: Sequence[str] = (),
    inputs: Inputs = "record",
) -> EquationErrorEstimate:
    """Estimate the parameters of an ODE from measured states, by least squares per equation.

    A state is known if the record has a signal of its name or an output that equals it (up to
    constants), or if it is the derivative of a known state (``theta' = q``). Equations with other
    states are left out: where known signals drive such a state, as a rotor lag, simulate it with
    `gb.simulate` and add it to the record, ``record.with_signals(rotor=...)``. All terms of an
    equation pass the same low-pass filter, so that smoothing affects both sides alike. Inputs that
    are not held are interpolated between samples by cubic splines. A transfer function can be used
    only if it has one pole.

    Parameters that do not enter linearly, such as delays, are held at their starts: give them with
    `fixed`, or leave them to `gb.fit`. Noise in the states biases the estimate.

    Parameters
    ----------
    model : Model
        Its inputs, states and outputs have the names of signals in the record.
    record : Record
        Uniform except for gaps, with every input; NaN marks missing samples.
    fixed : mapping of name to value
        Parameters held constant.
    free : sequence of str
        Parameters to estimate although the model declares them fixed.
    inputs : "record", "linear" or "held"
        How inputs vary between their samples, as in `OutputError`: by default as the record says.

    Raises
    ------
    ValueError
        For an unknown name, a missing input, constant signals, or non-uniform sampling; if nothing
        is free or determined; or if no equation can be used.
    """
    require_kind("record", record, Record, "a Record, as gb.prepare returns it")
    require_time(record, "equation_error")
    criterion = _NoOutputs(inputs=inputs)
    problem = Problem(model, record, criterion, fixed=fixed or {}, free=free)
    parameters = problem.parameters
    constants = {n: p.start for n, p in parameters.items() if p.fixed}
    unknown = {n: p for n, p in parameters.items() if not p.fixed}
    if not unknown:
        raise ValueError(f"{model.label} has no free parameter here: name some with free=(...).")

    system = dynamics(model)
    record = unrounded(record)
    for rows in runs_between_holes(record.time, record.clock):
        check_uniform(record.time[rows], record)
    start = start_values(unknown)
    equations = regressions(system, record.signals, constants)
    _require_equations(model, equations, record)
    between = dict(zip(system.inputs, between_samples(inputs, system.inputs, record), strict=True))
    rows, bands = regressors(equations, record, start, between)
    low, high = lower_and_upper(unknown[n] for n in equations.linear)
    # The equations are weighted by the sizes of their residuals, known only after a solution: at
    # first, nothing is explained. Weights and estimate determine one another; each pass changes the
    # weights less.
    values, errors = np.zeros(low.size), rows.target
    for _ in range(5 if len(bands) > 1 else 2):
        values = rows.solution(1 / rows.spread(errors, len(bands)), low, high)
        errors = rows.errors(values)
    groups = [tuple(equations.linear[k] for k in group) for group in undetermined(rows.slopes)]
    lost = {name for group in groups for name in group}
    pairs = zip(equations.linear, values.tolist(), strict=True)
    estimate = {name: value for name, value in pairs if name not in lost}
    if not estimate:
        names = ", ".join(equations.linear) or "the parameters linearly"
        raise ValueError(
            f"the record determines none of {names}: the signals that they multiply are constant, "
            "or only a combination of them is determined; fix some."
        )

    at_bound = tuple(name for name, value in estimate.items() if value in unknown[name].bounds)
    residuals = rows.spread(errors, len(bands))
    used = list[UsedEquation]()
    for k, (equation, band) in enumerate(zip(equations.equations, bands, strict=True)):
        of = rows.equation == k
        share = explained(rows.target[of], errors[of])
        numbers = share, int(of.sum()), band / math.tau, float(residuals[k])
        used.append(UsedEquation(equation.left, equation.parameters, *numbers))
    return EquationErrorEstimate(
        name=f"{model.label}, {record.name or 'record'}",
        estimate=estimate,
        equations=tuple(e for e in used if e.rows),
        left_out=(
            *equations.left_out,
            *(f"{e.left} (no stretch is long enough)" for e in used if not e.rows),
        ),
        missing={n: _why(n, equations, groups, p) for n, p in unknown.items() if n not in estimate},
        at_bound=at_bound,
        states=tuple(map(str, equations.states)),
        parameters=parameters,
        warnings=tuple(_warnings(used, at_bound)),
        inputs=described_inputs(inputs, system.inputs, record),
    )


class _NoOutputs(OutputError):  # noqa: N818  (no exception)
    """A criterion that compares no outputs: regressions may need only states."""

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


def explained(target: Array, errors: Array) -> float:
    """Return the explained share of the variance of an equation; NaN if it is constant."""
    variance = sum_of_squares(target - np.mean(target)) if target.size else 0.0
    return 1 - float(errors @ errors) / variance if variance > 0 else math.nan


def _why(
    name: str, equations: Equations, groups: Sequence[tuple[str, ...]], parameter: Parameter
) -> str:
    partners = next((group for group in groups if name in group), ())
    if len(partners) > 1:
        return f"only a combination of {', '.join(partners)} is determined: fix one of them"
    if partners:
        return "it has no effect in these data"
    if name in equations.nonlinear:
        return f"it does not enter linearly: held at its start {parameter.start:g}"
    return "it is in no equation that can be used"


def _warnings(used: Sequence[UsedEquation], at_bound: Sequence[str]) -> list[str]:
    bounded = [f"{n} ended at its bound." for n in at_bound]
    unexplained = [
        f"only {100 * max(e.r_squared, 0):.0f} % of the variance of {e.left} is explained: there "
        "is noise, or the model is incomplete."
        for e in used
        if e.rows and e.r_squared < 0.5
    ]
    return [*bounded, *unexplained]
