"""From a log to a fitted model in one call, with every choice explained.

Begin with `identify`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from greybox.data.record import Recording
from greybox.estimate.fit import fit
from greybox.estimate.result import Fit
from greybox.files.text_table import number, one_line, text_table
from greybox.formulation.frequency_criteria import MaximumLikelihood, RelativeLikelihood
from greybox.formulation.problem import Problem
from greybox.formulation.signal_units import as_the_only_pair
from greybox.identification.choices import Choice, choose
from greybox.identification.ladder import ladder_for
from greybox.identification.measurement import Measurement, measure
from greybox.logs.known_filters import KnownFilter
from greybox.logs.readers import read
from greybox.modeling.model_reference import included_model
from greybox.modeling.transfer_function import TransferFunction
from greybox.validation.compare import compare
from greybox.validation.comparison import Comparison

STARTS = 20


class FittedStep(NamedTuple):
    """A fitted structure: model, parameters that were freed, description, filters in series, criterion and fit."""

    model: str
    free: tuple[str, ...]
    about: str
    through: tuple[str, ...]
    criterion: str
    fit: Fit


@dataclass(frozen=True, eq=False)
class Identification:
    """A model from a log; printed, it explains every choice and the comparison of structures.

    Attributes
    ----------
    recording : Recording
    choices : tuple of Choice
        What was chosen, and why.
    measurement : Measurement
        The tests, the record, the response and its verdict.
    steps : tuple of FittedStep
        The structures, the simplest first.
    comparison : Comparison or None
        None if fewer than two structures converged.
    chosen : FittedStep or None
        The smallest structure that the data support, see `gb.compare`; None if none converged.
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
            parts += [str(self.fit)]
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
    """Go from a log to a fitted model: find the tests, measure the response, fit structures, and compare them.

    Every step is a function of its own (`read`, `greybox.identification.measure`, `fit`,
    `compare`), and every choice can be overridden by an argument.

    Parameters
    ----------
    log : str, Path or Recording
    ladder : sequence of (model, free, about), optional
        Structures, the simplest first, as ``("rate:DampedAngle", (), "rate damping")``; by default
        those of `greybox.identification.ladder` for the name of the output.
    declared : mapping of name to TransferFunction, optional
        Models of your own by their names in the ladder.
    through : sequence of str, optional
        Filters between the output and its log, by their names in the log, such as
        ``("gyro-filter",)``; ``()`` for none. By default those that the output is known to have
        passed.
    starts, seed : int
        Starts of every fit.
    **stated
        Fields of `greybox.identification.Settings`, such as ``axis="pitch"`` or
        ``output="theta=ATT.Pitch"``.

    Returns
    -------
    Identification
        `chosen` is the smallest structure whose BIC is within 2 of the least.

    Raises
    ------
    FileNotFoundError, KeyError, ValueError
        If the log has no usable test, or not what an argument names.
    """
    recording = log if isinstance(log, Recording) else read(log)
    settings, choices = choose(recording, **stated)
    measurement = measure(recording, settings)
    result = Identification(recording, choices, measurement, starts=starts, seed=seed)
    if measurement.response is None or not measurement.quality.usable:
        return result

    filters = _filters(measurement, through)
    ladder = ladder or ladder_for(settings.names[1][0])
    models = declared or {}
    steps = tuple(_fitted(measurement, step, models, filters, starts, seed) for step in ladder)
    converged = [step for step in steps if step.fit.converged]
    comparison = None
    if len(converged) > 1:
        labels = [str(1 + steps.index(step)) for step in converged]
        comparison = compare(*(step.fit for step in converged), labels=labels)
    chosen, reason = choose_structure(steps, comparison)
    return replace(result, steps=steps, comparison=comparison, chosen=chosen, reason=reason)


def filter_model(known: KnownFilter) -> TransferFunction:
    """Return the included model of a filter of a flight controller."""
    model: Any = included_model("greybox.models.filters", type(known).__name__)
    return model(*known.values)


def _filters(
    measurement: Measurement, names: Sequence[str] | None
) -> dict[str, tuple[KnownFilter, ...]]:
    """Return the filters of these names, or those that the output has passed before its log."""
    assert measurement.response is not None
    if names is None:
        passed = measurement.record.filters.get(measurement.response.output, ())
        filters = {n: f for n, f in measurement.filters.items() if set(f) <= set(passed)}
        return dict(sorted(filters.items(), key=lambda item: passed.index(item[1][0])))
    for name in names:
        if name not in measurement.filters:
            available = ", ".join(measurement.filters) or "none"
            raise ValueError(
                f"through={name} is no filter that the log states; it states {available}."
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
    file, _, name = reference.partition(":")
    included: Any = included_model(f"greybox.models.{file}", name)
    model = declared.get(reference) or included()
    assert measurement.response is not None
    for known in chain.from_iterable(filters.values()):
        model = model.through(filter_model(known))
    criterion = (
        MaximumLikelihood() if measurement.response.variance is not None else RelativeLikelihood()
    )
    data = as_the_only_pair(model, measurement.response)
    result = fit(Problem(model, data, criterion, free=tuple(free)), starts=starts, seed=seed)
    return FittedStep(reference, tuple(free), about, tuple(filters), criterion.name, result)


def choose_structure(
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
