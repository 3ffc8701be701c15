"""Units of a record against those that the model declares for its signals."""

import math

from greybox.data.record import Record
from greybox.data.units import Conversion, are_of_one_kind, to_si
from greybox.modeling.model import Model, require_known

# Relative difference of two factors that is rounding of how they are written.
ROUNDING = 1e-9


def check_units(model: Model, record: Record) -> None:
    """Check that the signals of a record are in the units that the model declares, as far as both are known.

    Raises
    ------
    ValueError
        For the first signal in another unit, with what converts it.
    """
    signals = (*model.input_names, *model.output_names)
    require_known(model.units, dict.fromkeys((*signals, *getattr(model, "states", ()))), "signal", model.label)
    for name in dict.fromkeys(signals):
        declared, given = model.units.get(name, "").strip(), record.units.get(name, "").strip()
        if not declared or not given or name not in record.signals:
            continue
        wanted, found = _known(declared), _known(given)
        if wanted is None or found is None:
            continue
        where = f"{name} is in {given} in the record {record.name!r} and in {declared} in {model.label}"
        if not are_of_one_kind(wanted, found):
            raise ValueError(f"{where}: these are different quantities, correct the unit or give the right signal.")
        factor = found.factor / wanted.factor
        zero = (found.zero - wanted.zero) / wanted.factor
        if not math.isclose(factor, 1.0, rel_tol=ROUNDING) or abs(zero) > ROUNDING:
            converted = f"{factor:.10g} * record[{name!r}]" + (f" + {zero:.10g}" if zero else "")
            raise ValueError(
                f"{where}: convert it, record.with_signals(units={{{name!r}: {declared!r}}}, {name}={converted})."
            )


def _known(unit: str) -> Conversion | None:
    """Return what a unit is in SI; None for one that is not known, with which nothing can be compared."""
    try:
        return to_si(unit)
    except ValueError:
        return None
