"""Units of a record or a response against those that the model declares for its signals."""

import math
from dataclasses import replace

from greybox.data.files.grouping import unique
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.data.units import are_of_one_kind, known_unit, misspelled, to_si
from greybox.modeling.model import Model, pick_signals, require_known

CONVERT = (
    "use SI units in both, record = record.in_si(), or convert the record, record = "
    "record.with_signals(units={{{name!r}: {unit!r}}}, {name}={factor:.10g} * record[{name!r}]"
    "{zero})"
)
MEASURE = "measure it in {unit}, or use SI units in both"


def check_units(model: Model, data: Record | TransientSpectrum) -> None:
    """Check that a record or a spectrum has the units of the model, where both are known.

    Raises
    ------
    ValueError
        For the first signal in another unit, with its conversion.
    """
    signals = (*model.input_names, *model.output_names)
    require_known(model.units, (*signals, *model.state_names), "signal", model.label)
    for name in unique(signals):
        if name in data.signals:
            place = f"the {data.noun} {data.name!r}" if data.name else f"the {data.noun}"
            _require_same_unit(model, name, data.units.get(name, ""), name, place, CONVERT)


def check_response_units(model: Model, response: FrequencyResponse) -> None:
    """Check that a response has the units of the model for its pair, where both are known.

    Raises
    ------
    ValueError
        For the first signal in another unit.
    """
    pair = pick_signals(model, response.input, response.output)
    names = {"input": response.input, "output": response.output}
    for name, (noun, in_response) in zip(pair, names.items(), strict=True):
        unit = response.units.get(in_response, "")
        label = f"the {noun} {name}"
        _require_same_unit(model, name, unit, label, "the response", MEASURE)


def _require_same_unit(
    model: Model, name: str, unit: str, label: str, place: str, cure: str
) -> None:
    """Raise ValueError with the cure if a signal has another unit than in the model."""
    declared = model.units.get(name, "").strip()
    unit = unit.strip()
    # Numbers in one unit, known or not, need no conversion.
    if unit == declared:
        return
    modeled, measured = known_unit(declared), known_unit(unit)
    if modeled is None or measured is None:
        # A unit of the user's own, such as counts, is equal to no other.
        unknown, owner = (unit, place) if modeled else (declared, model.label)
        if text := misspelled(unknown):
            raise ValueError(f"{label} in {owner}: {text}.")
        return

    reason = f"{label} is in {unit} in {place} and in {declared} in {model.label}"
    if not are_of_one_kind(modeled, measured):
        # A rate where an angle is expected is the usual mistake.
        is_rate = measured.si != "1" and are_of_one_kind(modeled, to_si(f"{measured.si}*s"))
        if is_rate and cure == MEASURE:
            cure = "take the model of the rate, or response.over_s()"
        else:
            cure = "correct the unit or give the right signal"
        raise ValueError(f"{reason}: these are different quantities, {cure}.")

    factor = measured.factor / modeled.factor
    zero = (measured.zero - modeled.zero) / modeled.factor
    # 1e-9: rounding of how the factors are written.
    if not math.isclose(factor, 1.0, rel_tol=1e-9) or abs(zero) > 1e-9:
        offset = f" + {zero:.10g}" if zero else ""
        cure = cure.format(name=name, unit=declared, factor=factor, zero=offset)
        raise ValueError(f"{reason}: {cure}.")


def as_the_only_pair(model: Model, response: FrequencyResponse) -> FrequencyResponse:
    """Return the response of the model's only pair without names of signals.

    Fits of other models then have the same data.

    Raises
    ------
    ValueError
        If its units are not those that the model declares.
    """
    if len(model.input_names) != 1 or len(model.output_names) != 1:
        return response
    names = dict(
        zip(
            (response.input, response.output),
            (*model.input_names, *model.output_names),
            strict=True,
        )
    )
    units = {names[name]: unit for name, unit in response.units.items() if name in names}
    named = replace(response, input=model.input_names[0], output=model.output_names[0], units=units)
    check_response_units(model, named)

    return replace(named, input="", output="", units={})
