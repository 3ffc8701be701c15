"""From a log to a fitted model in one go: the chain of the single verbs, with every choice said."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from greybox.data.record import Recording
from greybox.estimate.fit import fit
from greybox.estimate.result import Fit
from greybox.files.text_table import number, one_line, text_table, with_error
from greybox.formulation.frequency_criteria import MaximumLikelihood, RelativeLikelihood
from greybox.formulation.problem import Problem
from greybox.formulation.signal_units import as_the_only_pair
from greybox.identification.choices import Choice, choose
from greybox.identification.measurement import Measurement, measure
from greybox.logs.known_filters import KnownFilter
from greybox.logs.readers import read
from greybox.modeling.transfer_function import TransferFunction
from greybox.solve.minima import best_unfinished
from greybox.validation.compare import compare
from greybox.validation.comparison import Comparison

STARTS = 20


class FittedStep(NamedTuple):
    """One structure: the model by its name, what was freed, what it adds, the filters behind it, criterion and fit."""

    model: str
    free: tuple[str, ...]
    about: str
    through: tuple[str, ...]
    criterion: str
    fit: Fit


@dataclass(frozen=True, eq=False)
class Identification:
    """The chain from a log to a model. Printing it gives every choice, the ladder, and what to do next.

    Attributes
    ----------
    recording : Recording
    choices : tuple of Choice
        What was chosen, and why.
    measurement : Measurement
        The tests, the record, the response and its verdict.
    steps : tuple of FittedStep
        The ladder, the simplest structure first.
    comparison : Comparison or None
        None where fewer than two structures converged.
    chosen : FittedStep or None
        The smallest structure that the data support, see `gb.compare`; None where none converged.
    unfiltered : FittedStep or None
        The same structure without the filters of the log: their lag is then part of its own lag and
        delay.
    starts, seed : int
    """

    recording: Recording
    choices: tuple[Choice, ...]
    measurement: Measurement
    steps: tuple[FittedStep, ...] = ()
    comparison: Comparison | None = None
    chosen: FittedStep | None = None
    unfiltered: FittedStep | None = None
    starts: int = STARTS
    seed: int = 0
    reason: str = field(default="", repr=False)

    @property
    def fit(self) -> Fit | None:
        """The fit of the chosen structure."""
        return self.chosen.fit if self.chosen else None

    @property
    def next(self) -> tuple[str, ...]:
        """What to do next, in sentences."""
        return tuple(_next_steps(self))

    def commands(self, log: str = "", prefix: str = "") -> tuple[str, ...]:
        """Return the single commands that do the same; files are named after `prefix`."""
        log = log or self.recording.source
        return tuple(shlex.join(words) for words in _commands(self, log, prefix or Path(log).stem))

    def __repr__(self) -> str:
        return one_line(
            self, self.recording.source, self.chosen.model if self.chosen else "no model"
        )

    def __str__(self) -> str:
        parts = [
            "\n".join(["Chosen:", *(f"  {choice}" for choice in self.choices)])
            if self.choices
            else ""
        ]
        parts += [str(self.measurement), "\n".join(self.recording.findings)]
        if self.steps:
            parts += [_ladder(self), self.reason]
        if self.fit is not None:
            parts += [str(self.fit), _with_and_without(self)]
        parts += ["\n".join(["Next:", *(f"  {text}" for text in self.next)])]
        return "\n\n".join(part for part in parts if part)


def identify(
    log: str | Path | Recording,
    *,
    ladder: Sequence[Any] = (),
    declared: Mapping[str, TransferFunction] | None = None,
    through: Sequence[str] | None = None,
    starts: int = STARTS,
    seed: int = 0,
    **stated: Any,
) -> Identification:
    """Go from a log to a fitted model: find the tests, measure the response, fit a ladder of structures, compare.

    Every step is a verb of its own (`read`, `greybox.identification.measure`, `fit`, `compare`),
    and everything that is chosen may be stated instead.

    Parameters
    ----------
    log : str, Path or Recording
    ladder : sequence of (model, free, about), optional
        Structures from the simplest up, as ``("rate:DampedAngle", (), "rate damping")``; by default
        those of `greybox.models.ladder` for the output's name.
    declared : mapping of name to TransferFunction, optional
        Models of the ladder that greybox does not include, by the names that they have there.
    through : sequence of str, optional
        Filters between the output and its log, by the names that the log gives them,
        ``("gyro-filter",)``; ``()`` is none. By default those that the output is known to have
        passed.
    starts, seed : int
        Of every fit.
    **stated
        Fields of `greybox.identification.Settings`, as ``axis="pitch"`` or
        ``output="theta=ATT.Pitch"``.

    Returns
    -------
    Identification
        `chosen` is the smallest structure whose BIC is within 2 of the least: a larger one is not
        worth its parameters.

    Raises
    ------
    FileNotFoundError, KeyError, ValueError
        For a log without a usable test, and for what is stated and is not there.
    """
    recording = log if isinstance(log, Recording) else read(log)
    settings, choices = choose(recording, **stated)
    measurement = measure(recording, settings)
    result = Identification(recording, choices, measurement, starts=starts, seed=seed)
    if measurement.response is None or not measurement.quality.usable:
        return result

    filters = _filters(measurement, through)
    known = declared or {}
    ladder = ladder or _ladder_of(settings.names[1][0])
    steps = tuple(_fitted(measurement, step, known, filters, starts, seed) for step in ladder)
    converged = [step for step in steps if step.fit.converged]
    labels = [str(1 + steps.index(step)) for step in converged]
    comparison = (
        compare(*(step.fit for step in converged), labels=labels) if len(converged) > 1 else None
    )
    chosen, reason = _chosen(steps, comparison)
    reason = " ".join([reason, *_closer(steps, chosen)])
    unfiltered = (
        _fitted(measurement, chosen[:3], known, {}, starts, seed) if filters and chosen else None
    )
    return Identification(
        recording, choices, measurement, steps, comparison, chosen, unfiltered, starts, seed, reason
    )


def _ladder_of(output: str) -> Sequence[Any]:
    """Return the included structures for an output; they are models, which this folder knows nothing of."""
    ladders = import_module("greybox.models.ladder").LADDERS
    if output not in ladders:
        raise ValueError(
            f"no structures are known for the output {output!r}: name it as one of {', '.join(ladders)}, e.g. --output "
            f"{next(iter(ladders))}=SIGNAL."
        )
    return ladders[output]


def filter_model(known: KnownFilter) -> TransferFunction:
    """Return the included model of a filter of a flight controller."""
    return getattr(import_module("greybox.models.filters"), type(known).__name__)(*known.values)


def _filters(
    measurement: Measurement, names: Sequence[str] | None
) -> dict[str, tuple[KnownFilter, ...]]:
    """Return the filters of these names, or those that the output has passed before its log."""
    assert measurement.response is not None
    passed = measurement.record.filters.get(measurement.response.output, ())
    if names is None:
        known = {name: f for name, f in measurement.filters.items() if set(f) <= set(passed)}
        return {
            name: known[name]
            for name in sorted(known, key=lambda name: passed.index(known[name][0]))
        }
    for name in names:
        if name not in measurement.filters:
            there = ", ".join(measurement.filters) or "none"
            raise ValueError(
                f"--through {name}: the log tells of no such filter; it tells of {there}."
            )
    return {name: measurement.filters[name] for name in names}


def _fitted(
    measurement: Measurement,
    step: Any,
    declared: Mapping[str, TransferFunction],
    filters: Mapping[str, tuple[KnownFilter, ...]],
    starts: int,
    seed: int,
) -> FittedStep:
    reference, free, about = step
    model = declared.get(reference) or _included(reference)
    assert measurement.response is not None
    for known in chain.from_iterable(filters.values()):
        model = model.through(filter_model(known))
    criterion = (
        MaximumLikelihood() if measurement.response.variance is not None else RelativeLikelihood()
    )
    data = as_the_only_pair(model, measurement.response)
    result = fit(Problem(model, data, criterion, free=tuple(free)), starts=starts, seed=seed)
    return FittedStep(reference, tuple(free), about, tuple(filters), criterion.name, result)


def _included(reference: str) -> TransferFunction:
    file, _, name = reference.partition(":")
    return getattr(import_module(f"greybox.models.{file}"), name)()


def _chosen(
    steps: Sequence[FittedStep], comparison: Comparison | None
) -> tuple[FittedStep | None, str]:
    """Return the smallest structure of the ladder that the data support, by the verdict of all comparisons, and why."""
    converged = [step for step in steps if step.fit.converged]
    if comparison is None:
        return (
            (converged[0], "Only one structure converged.")
            if converged
            else (None, "No structure converged.")
        )
    if not comparison.supported:
        return converged[0], "The costs cannot be compared: the simplest structure is shown."
    return converged[
        comparison.labels.index(comparison.supported)
    ], f"Structure {comparison.verdict}"


def _closer(steps: Sequence[FittedStep], chosen: FittedStep | None) -> list[str]:
    """Name the structures that did not converge, although a run of theirs came as close as the chosen one, by AIC."""
    if chosen is None:
        return []
    runs = [
        (k, step, best_unfinished(step.fit.runs))
        for k, step in enumerate(steps, 1)
        if not step.fit.converged
    ]
    return [
        f"Structure {k} did not converge, but came to a cost of {number(run.cost, 4)} where the chosen one has "
        f"{number(chosen.fit.cost, 4)}: fit {step.model} by itself, with --search multistart or more --starts."
        for k, step, run in runs
        if run is not None
        and run.cost + len(step.fit.free) < chosen.fit.cost + len(chosen.fit.free)
    ]


def _ladder(result: Identification) -> str:
    header = ("", "structure", "free", "cost", "BIC", "less the least", "what it is")
    rows = []
    for k, step in enumerate(result.steps, start=1):
        label = str(k)
        known = result.comparison is not None and label in result.comparison.labels
        measures = ("BIC", "BIC less the least")
        values = [
            result.comparison.value(m, label) if known and result.comparison else None
            for m in measures
        ]
        cells = ["-" if value is None else number(round(value, 6), 4) for value in values]
        cost = number(step.fit.cost, 4) if step.fit.converged else "failed"
        name = step.model + (f" with {', '.join(step.free)} free" if step.free else "")
        rows.append((label, name, str(len(step.fit.free)), cost, *cells, step.about))
    through = result.steps[0].through
    title = (
        f"Structures, in series with the {' and the '.join(through)} of the log:"
        if through
        else "Structures:"
    )
    return "\n".join([title, text_table(header, rows, left=(1, 6))])


def _with_and_without(result: Identification) -> str:
    """Return lags and delays beside those of the same structure without the filters, which take up their lag."""
    with_, without = result.chosen, result.unfiltered
    if with_ is None or without is None or not without.fit.converged:
        return ""
    times = [q.name for q in with_.fit.quantities if q.kind == "free" and q.unit == "s"]
    rows = [
        (f"{name}, s", *(_with_error(step.fit, name) for step in (with_, without)))
        for name in times
    ]
    if not rows:
        return ""
    names = " and ".join(with_.through)
    return f"Lag and delay with and without the {names}:\n" + text_table(
        ("", "with", "without"), rows
    )


def _with_error(fit: Fit, name: str) -> str:
    return " ± ".join(with_error(fit.estimate[name], fit.standard_error[name]))


def _next_steps(result: Identification) -> list[str]:
    if result.fit is None or result.chosen is None:
        return (
            ["Fly the test again, with what the verdict above asks for."]
            if not result.steps
            else [
                "No structure converged: look at the response, and fit a model of your own, greybox new model NAME."
            ]
        )
    said = []
    if result.chosen is result.steps[-1]:
        said.append(
            "The largest structure was needed: look for what it still misses in the figure, and add it."
        )
    estimate, error = result.fit.estimate, result.fit.standard_error
    weak = [name for name in result.fit.free if not abs(estimate[name]) > 2 * error[name]]
    if weak:
        are = "is" if len(weak) == 1 else "are"
        said.append(
            f"{', '.join(weak)} {are} not distinguishable from zero: try --fix {weak[0]}=0, or excite higher."
        )
    said.append(
        "Hold the model against a flight that it has not seen: greybox identify OTHER_LOG, and compare the estimates."
    )
    return said


def _commands(result: Identification, log: str, prefix: str) -> list[list[str]]:
    settings = result.measurement.settings
    finding = ["--announced", settings.announced] if settings.announced else []
    finding += (
        ["--fields", *(f"{key}={name}" for key, name in settings.fields.items())]
        if settings.fields
        else []
    )
    finding += ["--setpoint", settings.setpoint] if settings.setpoint else []
    response = f"{prefix}_response.csv"
    measured = [
        "greybox",
        "response",
        log,
        "--input",
        settings.input,
        "--output",
        settings.output,
        *finding,
    ]
    for flag, value, usual in (
        ("--axis", settings.axis, ""),
        ("--tests", settings.tests, ""),
        ("--instrument", settings.instrument, ""),
        ("--rate", settings.rate, None),
        ("--settle", settings.settle, 2.0),
        ("--period", settings.period, None),
        ("--method", settings.method, "least-squares"),
        ("--points", settings.points, 40),
    ):
        measured += [flag, str(value)] if value != usual else []
    measured += ["--band", *(repr(float(edge)) for edge in settings.band)] if settings.band else []
    measured += [
        flag
        for flag, on in (("--whole", settings.whole), ("--open-loop", settings.open_loop))
        if on
    ]
    found = [["greybox", "inspect", log, *finding], [*measured, "--out", response]]
    for step in (result.chosen,) if result.chosen else ():
        words = ["greybox", "fit", "--model", step.model, "--data", response]
        words += ["--through", *step.through] if step.through else []
        words += ["--free", *step.free] if step.free else []
        words += ["--criterion", step.criterion]
        words += ["--starts", str(result.starts), "--seed", str(result.seed)]
        found.append([*words, "--out", f"{prefix}_fit.h5", "--plot", f"{prefix}.png"])
    return found
