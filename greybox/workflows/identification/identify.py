"""From logs to a fitted model in one call, with every choice explained.

Begin with `identify`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from greybox.assessment.fit import fit
from greybox.assessment.printed import (
    has_systematic_errors,
    table_of_parameters,
    text as text_of_fit,
)
from greybox.assessment.result import Fit
from greybox.assessment.transfer_function_numbers import (
    TransferFunctionNumbers,
    transfer_function_numbers,
)
from greybox.data.files.argument_checks import checked_items
from greybox.data.files.arrays import Interval
from greybox.data.files.folded_text import folded
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values, attributes, non_empty
from greybox.data.files.printed import one_line
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.logs.known_filters import KnownFilter, KnownFilters
from greybox.data.logs.readers import read
from greybox.data.record import Recording
from greybox.data.spectral.experiment_quality import COHERENCE, Finding
from greybox.modeling.model import Model, require_known
from greybox.modeling.model_reference import included_model
from greybox.modeling.transfer_function import TransferFunction
from greybox.workflows.identification.choices import Choice, choose
from greybox.workflows.identification.measurement import Measurement, measure
from greybox.workflows.identification.orders import STARTS, select_orders
from greybox.workflows.identification.selection import Candidate, Selection, held_by_bounds, select
from greybox.workflows.identification.structure_fit import (
    Structure,
    problem_of_structure,
    stated_for,
)


@public
@frozen
class Identification:
    """A model from logs; printed, it explains every choice and the comparison of structures.

    Attributes
    ----------
    recordings : tuple of Recording
    choices : tuple of Choice
        What was chosen in the first log, and why.
    measurements : tuple of Measurement
        What was measured in every log: the tests, the record, the response and its verdict.
    selection : Selection or None
        The structures, the chosen one and the verdict; None if a response was refused.
    through : tuple of str
        Filters between the output and its log.
    """

    recordings: tuple[Recording, ...]
    choices: tuple[Choice, ...]
    measurements: tuple[Measurement, ...]
    selection: Selection | None = None
    through: tuple[str, ...] = ()

    @property
    def measurement(self) -> Measurement:
        """The measurement of the first log."""
        return self.measurements[0]

    @property
    def refusals(self) -> tuple[str, ...]:
        """Why responses are not a basis for a model."""
        return tuple(chain.from_iterable(m.quality.refusals for m in self.measurements))

    @property
    def fit(self) -> Fit | None:
        """The fit of the chosen structure; it warns if the structure does not explain the data."""
        return self.selection.fit if self.selection else None

    @property
    def transfer_function(self) -> TransferFunctionNumbers | None:
        """The fitted transfer function with its numbers; None without a fit or a rational form."""
        return transfer_function_numbers(self.fit) if self.fit and self.fit.converged else None

    def __repr__(self) -> str:
        chosen = self.selection.chosen if self.selection else None
        sources = ", ".join(recording.source for recording in self.recordings)
        return one_line(self, sources, chosen.label if chosen else "no model")

    @property
    def details(self) -> str:
        """What the text leaves out: the tests, the responses, all structures, and the fit's own."""
        parts = [self._chosen, *self._measured(str)]
        if self.selection is not None:
            parts.append(f"{self._structures}:\n{self.selection}")
        if self.fit is not None:
            parts += [table_of_parameters(self.fit), self.fit.details]
        return "\n\n".join(filter(None, parts))

    def __str__(self) -> str:
        # Without a fit, the tests and their defects are the answer.
        if self.selection is None:
            return "\n\n".join(filter(None, [self._chosen, *self._measured(str)]))
        measured = self._measured(attrgetter("brief"))
        structures = f"{self._structures}:\n{self.selection.brief}"
        return folded(
            "\n\n".join(filter(None, [self._answer, self._chosen, *measured, structures]))
        )

    @property
    def _answer(self) -> str:
        """The chosen structure: its verdict and its numbers."""
        fit, numbers = self.fit, self.transfer_function
        if fit is None:
            return ""
        if numbers is None:
            return str(fit)
        # The coefficients of a rational structure are no quantities of the reader's.
        is_rational = all(q.has_computed_bounds for q in fit.quantities if q.kind == "free")
        # Only the table of the parameters shows what longer tests do not reduce.
        if is_rational and not has_systematic_errors(fit):
            return text_of_fit(fit, str(numbers))
        return f"{fit}\n\nTransfer function:\n{numbers}"

    @property
    def _chosen(self) -> str:
        """What was chosen in the log, and why."""
        lines = [f"  {choice}" for choice in self.choices]
        return "\n".join(["Chosen:", *lines]) if lines else ""

    @property
    def _structures(self) -> str:
        """What the structures have in common."""
        series = f", in series with the {' and the '.join(self.through)} of the log"
        return "Structures" + (series if self.through else "")

    def _measured(self, text_of: Callable[[Measurement], str]) -> Iterator[str]:
        """Yield the measurement of each log with the findings of the log."""
        for recording, measurement in zip(self.recordings, self.measurements, strict=True):
            yield "\n".join([text_of(measurement), *recording.findings])


@public
def identify(  # noqa: PLR0913 - every choice that an analyst makes
    log: str | Path | Recording | Sequence[str | Path | Recording],
    *,
    structures: Sequence[Model | Structure] = (),
    through: Sequence[str] | None = None,
    fixed: Values | None = None,
    free: Sequence[str] = (),
    bounds: Mapping[str, Interval] | None = None,
    start: Values | None = None,
    all_points: bool = False,
    starts: int = STARTS,
    seed: int = 0,
    **stated: Any,
) -> Identification:
    """Go from a log to a fitted model: measure the response of the tests, and fit structures.

    By default nothing is assumed of the vehicle: the structures are rational transfer functions of
    rising order with a delay, see `select_orders`. Every step is a function of its own (`read`,
    `greybox.identification.measure`, `select_orders`), and every choice can be overridden
    by an argument. The verdict of the selection says whether the chosen structure explains the
    data.

    Parameters
    ----------
    log : str, Path or Recording, or a sequence of them
        Several logs with tests of one axis are fitted together.
    structures : sequence of Model or Structure, optional
        Fit these instead, within their declared bounds.
    through : sequence of str, optional
        Filters between the output and its log, by their names in the log, such as
        ``("gyro-filter",)``; ``()`` for none. By default those that the output is known to have
        passed.
    fixed, free, bounds, start : of parameters, optional
        As in `Problem`, for the structures that have the parameter.
    all_points : bool
        Also fit the frequencies that the check of the response warns about.
    starts, seed : int
        Starts of every fit of `structures`, or other starts of the chosen rational one.
    **stated
        Fields of `greybox.identification.Settings`, such as ``axis="pitch"`` or
        ``output="theta=ATT.Pitch"``.

    Raises
    ------
    FileNotFoundError, KeyError, ValueError
        If a log has no usable test, or not what an argument names.

    Examples
    --------
    >>> from greybox.models.rate import DampedAngle
    >>> from greybox.problems import sitl_pitch
    >>> found = gb.identify(sitl_pitch.LOG, structures=[DampedAngle()], starts=4)
    >>> found.selection.explains
    True
    """
    logs: Sequence[Any] = log if isinstance(log, list | tuple) else [log]
    recordings = [item if isinstance(item, Recording) else read(item) for item in logs]
    # Records made in memory have no checksum, and cannot be compared.
    checksums = {recording.checksum for recording in recordings if recording.checksum}
    if len(checksums) not in (0, len(recordings)):
        raise ValueError("a log is given twice: its errors would count as independent.")
    stated |= {"drop_warned": not all_points, "refined": True}
    first, *others = recordings
    settings, choices = choose(first, **stated)
    all_settings = [settings]
    # The first log decides the signals of all: two sensors have two responses.
    stated |= attributes(settings, "input", "output", "axis")
    for recording in others:
        settings, _ = choose(recording, **stated)
        all_settings.append(settings)
    measurements = []
    for recording, settings in zip(recordings, all_settings, strict=True):
        measurements.append(_judged(measure(recording, settings)))
    result = Identification(tuple(recordings), choices, tuple(measurements))
    if result.refusals:
        return result

    responses = [m.response for m in measurements if m.response is not None]
    filters = _filters(measurements[0], through)
    series = [filter_model(known) for known in chain.from_iterable(filters.values())]
    options = non_empty({"fixed": fixed, "free": free, "bounds": bounds, "start": start})
    models = checked_items("a structure", structures, Structure | Model, "models, as DampedAngle()")
    if models:
        listed = [m if isinstance(m, Structure) else Structure(m, m.label) for m in models]
        names = chain.from_iterable(structure.model.parameters for structure in listed)
        stated_names = chain.from_iterable(options.values())
        require_known(stated_names, names, "parameter", "the list of structures")
        candidates = [_candidate(s, responses, series, options, starts, seed) for s in listed]
        selection = select(candidates)
    else:
        # The structures of the first response are used for all, unless a filter is divided out of
        # it.
        linear = {} if series else measurements[0].linear
        selection = select_orders(
            responses, through=series, linear=linear, starts=starts, seed=seed, **options
        )
    return replace(result, selection=selection, through=tuple(filters))


def filter_model(known: KnownFilter) -> TransferFunction:
    """Return the included model of a filter of a flight controller."""
    model: Any = included_model("greybox.models.filters", type(known).__name__)
    return model(*known.values)


def _judged(measurement: Measurement) -> Measurement:
    """Return a measurement, its response refused if it is too poor for a model."""
    response = measurement.response
    if response is None:
        return measurement
    low, high = float(response.omega.min()), float(response.omega.max())
    refusals = []
    # Within an octave, gain and slope cannot be distinguished from a lag or a delay.
    if high < 2 * low:
        text = f"the response covers {low:.4g} to {high:.4g} rad/s, less than an octave: "
        text += "no basis for a model."
        refusals.append(Finding("spread", "refusal", high / low, text))
    coherence = 1.0 if response.coherence is None else float(np.median(response.coherence))
    if coherence < COHERENCE.warning:
        text = f"half of the points have a coherence below {coherence:.2f}: no basis for a model."
        refusals.append(Finding("coherence", "refusal", coherence, text))
    return replace(measurement, quality=measurement.quality.with_findings(*refusals))


def _filters(measurement: Measurement, names: Sequence[str] | None) -> KnownFilters:
    """Return the filters of these names, or those that the output has passed before its log."""
    assert measurement.response is not None
    if names is None:
        # Only filters that are certain to lie between the vehicle and this signal, in their order.
        passed = measurement.record.filters.get(measurement.response.output, ())
        certain = [name for name, known in measurement.filters.items() if set(known) <= set(passed)]
        names = sorted(certain, key=lambda name: passed.index(measurement.filters[name][0]))
    require_known(names, measurement.filters, "filter", "the log")
    return {name: measurement.filters[name] for name in names}


def _candidate(
    structure: Structure,
    responses: Sequence[FrequencyResponse],
    series: Sequence[TransferFunction],
    stated: Mapping[str, Any],
    starts: int,
    seed: int,
) -> Candidate:
    """Fit a structure behind filters in series."""
    model: Any = structure.model
    options = stated_for(model, stated)
    free = {*structure.free, *options.pop("free", ())} - {*options.get("fixed", {})}
    for known in series:
        model = model.through(known)
    problem = problem_of_structure(model, responses, free=sorted(free), **options)
    result = fit(problem, starts, seed, profiles=False, progress=False)
    return Candidate(structure.name, result, "stated", held_by_bounds(result))
