"""Units of a record or a response against those that the model declares for its signals."""

import math
from dataclasses import replace

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.data.units import Conversion, are_of_one_kind, to_si
from greybox.modeling.model import Model, pick_signals, require_known

# Relative difference of two factors that is rounding of how they are written.
ROUNDING = 1e-9


def check_units(model: Model, data: Record | TransientSpectrum) -> None:
    """Check that the signals of a record or a spectrum are in the units of the model, as far as both are known.

    Raises
    ------
    ValueError
        For the first signal in another unit, with what converts it.
    """
    signals = (*model.input_names, *model.output_names)
    require_known(
        model.units, dict.fromkeys((*signals, *getattr(model, "states", ()))), "signal", model.label
    )
    for name in dict.fromkeys(signals):
        declared, given = model.units.get(name, "").strip(), data.units.get(name, "").strip()
        if not declared or not given or name not in data.signals:
            continue
        wanted, found = _known(declared), _known(given)
        if wanted is None or found is None:
            continue
        noun = "record" if isinstance(data, Record) else "spectrum"
        where = (
            f"{name} is in {given} in the {noun} {data.name!r} and in {declared} in {model.label}"
        )
        if not are_of_one_kind(wanted, found):
            raise ValueError(
                f"{where}: these are different quantities, correct the unit or give the right signal."
            )
        factor = found.factor / wanted.factor
        zero = (found.zero - wanted.zero) / wanted.factor
        if not math.isclose(factor, 1.0, rel_tol=ROUNDING) or abs(zero) > ROUNDING:
            converted = f"{factor:.10g} * record[{name!r}]" + (f" + {zero:.10g}" if zero else "")
            if not isinstance(data, Record):
                raise ValueError(f"{where}: convert the record that the spectrum was made of.")
            raise ValueError(
                f"{where}: convert it, record.with_signals(units={{{name!r}: {declared!r}}}, {name}={converted})."
            )


def check_response_units(model: Model, response: FrequencyResponse) -> None:
    """Check that a response is in the units that the model declares for its pair, as far as both are known.

    Raises
    ------
    ValueError
        For the first signal in another unit, with what converts the response.
    """
    names = pick_signals(model, response.input, response.output)
    for name, given_name, what in zip(
        names, (response.input, response.output), ("input", "output"), strict=True
    ):
        declared, given = (
            model.units.get(name, "").strip(),
            response.units.get(given_name, "").strip(),
        )
        wanted, found = _known(declared) if declared else None, _known(given) if given else None
        if wanted is None or found is None:
            continue
        where = (
            f"the {what} {name} is in {given} in the response and in {declared} in {model.label}"
        )
        if not are_of_one_kind(wanted, found):
            rate = found.si != "1" and are_of_one_kind(wanted, to_si(f"{found.si}*s"))
            cure = (
                "take the model of the rate, or response.over_s()"
                if rate
                else "give the right signal"
            )
            raise ValueError(f"{where}: these are different quantities, {cure}.")
        factor = found.factor / wanted.factor
        if not math.isclose(factor, 1.0, rel_tol=ROUNDING):
            raise ValueError(f"{where}: measure it in {declared}, as gb.prepare does from logs.")


def as_the_only_pair(model: Model, response: FrequencyResponse) -> FrequencyResponse:
    """Return the response without names, of the model's only pair, so that fits of other models have the same data.

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


def _known(unit: str) -> Conversion | None:
    """Return what a unit is in SI; None for one that is not known, with which nothing can be compared."""
    try:
        return to_si(unit)
    except ValueError:
        return None
