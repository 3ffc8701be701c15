"""From a log to a fitted model in one go: the chain of the single verbs, with every choice said."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from greybox.data.record import Recording
from greybox.data.text_table import number, one_line, text_table
from greybox.estimate.fit import fit
from greybox.estimate.result import Fit
from greybox.formulation.frequency_criteria import Criterion, MaximumLikelihood, RelativeLikelihood
from greybox.formulation.problem import Problem
from greybox.formulation.signal_units import as_the_only_pair
from greybox.identification.choices import Choice, choose
from greybox.identification.measurement import Measurement, measure
from greybox.logs.readers import read
from greybox.modeling.transfer_function import TransferFunction
from greybox.validation.compare import compare
from greybox.validation.comparison import Comparison
from greybox.validation.parsimony import BARE_MENTION

STARTS = 20


class FittedStep(NamedTuple):
    """One structure: the model by its name, what was freed, what it adds, the filter behind it, criterion and fit."""

    model: str
    free: tuple[str, ...]
    about: str
    through: str
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
        The simplest structure that no other one describes the data better than; None where none converged.
    starts, seed : int
    """

    recording: Recording
    choices: tuple[Choice, ...]
    measurement: Measurement
    steps: tuple[FittedStep, ...] = ()
    comparison: Comparison | None = None
    chosen: FittedStep | None = None
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
        return one_line(self, self.recording.source, self.chosen.model if self.chosen else "no model")

    def __str__(self) -> str:
        parts = ["\n".join(["Chosen:", *(f"  {choice}" for choice in self.choices)]) if self.choices else ""]
        parts += [str(self.measurement), "\n".join(self.recording.findings)]
        if self.steps:
            parts += [_ladder(self), self.reason]
        if self.fit is not None:
            parts += [str(self.fit)]
        parts += ["\n".join(["Next:", *(f"  {text}" for text in self.next)])]
        return "\n\n".join(part for part in parts if part)


def identify(
    log: str | Path | Recording, *, ladder: Sequence[Any] = (), starts: int = STARTS, seed: int = 0, **stated: Any
) -> Identification:
    """Go from a log to a fitted model: find the tests, measure the response, fit a ladder of structures, compare.

    Every step is a verb of its own (`read`, `greybox.identification.measure`, `fit`, `compare`), and everything that is
    chosen may be stated instead.

    Parameters
    ----------
    log : str, Path or Recording
    ladder : sequence of (model, free, about), optional
        Structures from the simplest up, as ``("rate:DampedAngle", (), "rate damping")``; by default those of
        `greybox.models.ladder` for the output's name.
    starts, seed : int
        Of every fit.
    **stated
        Fields of `greybox.identification.Settings`, as ``axis="pitch"`` or ``output="theta=ATT.Pitch"``.

    Returns
    -------
    Identification
        `chosen` is the simplest structure whose BIC is within 2 of the least: a larger one is not worth its parameters.

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

    criterion = MaximumLikelihood() if measurement.response.variance is not None else RelativeLikelihood()
    steps = tuple(
        _fitted(measurement, criterion, step, starts, seed) for step in (ladder or _ladder_of(settings.names[1][0]))
    )
    converged = [step for step in steps if step.fit.converged]
    labels = [str(1 + steps.index(step)) for step in converged]
    comparison = compare(*(step.fit for step in converged), labels=labels) if len(converged) > 1 else None
    chosen, reason = _chosen(steps, comparison)
    return Identification(recording, choices, measurement, steps, comparison, chosen, starts, seed, reason)


def _ladder_of(output: str) -> Sequence[Any]:
    """Return the included structures for an output; they are models, which this folder knows nothing of."""
    ladders = import_module("greybox.models.ladder").LADDERS
    if output not in ladders:
        raise ValueError(
            f"no structures are known for the output {output!r}: name it as one of {', '.join(ladders)}, e.g. --output "
            f"{next(iter(ladders))}=SIGNAL."
        )
    return ladders[output]


def _fitted(measurement: Measurement, criterion: Criterion, step: Any, starts: int, seed: int) -> FittedStep:
    reference, free, about = step
    file, _, name = reference.partition(":")
    model: TransferFunction = getattr(import_module(f"greybox.models.{file}"), name)()
    words = []
    assert measurement.response is not None
    for known in measurement.record.filters.get(measurement.response.output, ()):
        low_pass = import_module("greybox.models.filters").LowPass(known.cutoff, known.damping)
        model = model.through(low_pass)
        words.append(f"filters:LowPass({known.cutoff!r}, {known.damping!r})")
    data = as_the_only_pair(model, measurement.response)
    result = fit(Problem(model, data, criterion, free=tuple(free)), starts=starts, seed=seed)
    return FittedStep(reference, tuple(free), about, " ".join(words), criterion.name, result)


def _chosen(steps: Sequence[FittedStep], comparison: Comparison | None) -> tuple[FittedStep | None, str]:
    """Return the simplest structure of the ladder that describes the data as well as any, and why."""
    converged = [step for step in steps if step.fit.converged]
    if comparison is None:
        return (converged[0], "Only one structure converged.") if converged else (None, "No structure converged.")
    above = [comparison.value("BIC less the least", label) for label in comparison.labels]
    if any(value is None for value in above):
        return converged[0], "The costs cannot be compared: the simplest structure is shown."
    known = [float(value) for value in above if value is not None]
    k = next(i for i, value in enumerate(known) if value <= BARE_MENTION)
    best = known.index(min(known))
    label = comparison.labels[k]
    if k == best == 0:
        return converged[0], f"Structure {label} is chosen: it is the simplest, and has the least BIC."
    if k == best:
        return converged[
            k
        ], f"Structure {label} is chosen: it has the least BIC, and simpler ones have at least {BARE_MENTION:g} more."
    return converged[k], (
        f"Structure {label} is chosen: it is the simplest whose BIC is within {BARE_MENTION:g} of the least "
        f"(structure {comparison.labels[best]}, {known[k]:.2g} less), which is not worth more than a bare mention."
    )


def _ladder(result: Identification) -> str:
    header = ("", "structure", "free", "cost", "BIC", "less the least", "what it is")
    rows = []
    for k, step in enumerate(result.steps, start=1):
        label = str(k)
        known = result.comparison is not None and label in result.comparison.labels
        measures = ("BIC", "BIC less the least")
        values = [result.comparison.value(m, label) if known and result.comparison else None for m in measures]
        cells = ["-" if value is None else number(round(value, 6), 4) for value in values]
        cost = number(step.fit.cost, 4) if step.fit.converged else "failed"
        name = step.model + (f" with {', '.join(step.free)} free" if step.free else "")
        rows.append((label, name, str(len(step.fit.free)), cost, *cells, step.about))
    title = "Structures, behind the filter that the log names:" if result.steps[0].through else "Structures:"
    return "\n".join([title, text_table(header, rows, left=(1, 6))])


def _next_steps(result: Identification) -> list[str]:
    if result.fit is None or result.chosen is None:
        return (
            ["Fly the test again, with what the verdict above asks for."]
            if not result.steps
            else ["No structure converged: look at the response, and fit a model of your own, greybox new model NAME."]
        )
    said = []
    if result.chosen is result.steps[-1]:
        said.append("The largest structure was needed: look for what it still misses in the figure, and add it.")
    estimate, error = result.fit.estimate, result.fit.standard_error
    weak = [name for name in result.fit.free if not abs(estimate[name]) > 2 * error[name]]
    if weak:
        are = "is" if len(weak) == 1 else "are"
        said.append(f"{', '.join(weak)} {are} not distinguishable from zero: try --fix {weak[0]}=0, or excite higher.")
    said.append(
        "Hold the model against a flight that it has not seen: greybox identify OTHER_LOG, and compare the estimates."
    )
    return said


def _commands(result: Identification, log: str, prefix: str) -> list[list[str]]:
    settings = result.measurement.settings
    finding = ["--announced", settings.announced] if settings.announced else []
    finding += ["--fields", *(f"{key}={name}" for key, name in settings.fields.items())] if settings.fields else []
    finding += ["--setpoint", settings.setpoint] if settings.setpoint else []
    response = f"{prefix}_response.csv"
    measured = ["greybox", "response", log, "--input", settings.input, "--output", settings.output, *finding]
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
    measured += [flag for flag, on in (("--whole", settings.whole), ("--open-loop", settings.open_loop)) if on]
    found = [["greybox", "inspect", log, *finding], [*measured, "--out", response]]
    for step in (result.chosen,) if result.chosen else ():
        words = ["greybox", "fit", "--model", step.model, "--data", response]
        words += ["--through", step.through] if step.through else []
        words += ["--free", *step.free] if step.free else []
        words += ["--criterion", step.criterion]
        words += ["--starts", str(result.starts), "--seed", str(result.seed)]
        found.append([*words, "--out", f"{prefix}_fit.h5", "--plot", f"{prefix}.png"])
    return found
