"""Columns of a table under the user's names."""

from collections.abc import Mapping

from greybox.data.dates import OF_DAY, SINCE_1970
from greybox.data.files.arrays import Array
from greybox.data.headings import Heading, find_column, unit_and_hold, unit_in_name
from greybox.data.time_column import unit_of_clock
from greybox.data.units import AmbiguousUnitError, is_unit, known_unit, misspelled, to_si


def renamed(
    columns: Mapping[str, Array], units: Mapping[str, str], stated: Mapping[str, str], source: str
) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the columns of a table in its order, the stated ones under their new names, and units.

    Raises
    ------
    ValueError
        If a column does not exist, its unit is not known, or the table has it in another unit.
    """
    header = [Heading(name, units.get(name, "")) for name in columns]
    own = [*columns]
    own_names: dict[str, str] = {}
    labels: dict[str, str] = {}
    for name, text in stated.items():
        try:
            place, unit = find_column(text, header)
            own_names[name] = own[place]
            # A word on the hold alone leaves the unit in the name valid.
            unit, hold = unit_and_hold(unit)
            # dCL/deg is a derivative, dE/deg may be an elevator.
            if not unit and own[place].startswith("d") and own[place].endswith("/deg"):
                raise ValueError("is in degrees or per degree: add :deg or :1/deg")
            in_name = unit_in_name(own[place]) or unit_of_clock(own[place])
            unit = f"{unit or in_name} {hold}".strip()
            labels[name] = _agreed(unit, units.get(own[place], ""))
        except ValueError as error:
            sentence = str(error)
            if sentence.startswith("has no column") and not sentence.endswith("?"):
                sentence += f" If other files have it, name both: {name}={text},COLUMN."
            joint = " " if sentence.startswith("has ") else f": {text}: "
            stop = "" if sentence.endswith((".", "?")) else "."
            raise ValueError(f"{source}{joint}{sentence}{stop}") from None

    # The others stay under their own names, which may be those of the model.
    unnamed = [name for name in own if name not in (*own_names, *own_names.values())]
    own_names |= {name: name for name in unnamed}
    labels |= {name: unit for name in unnamed if (unit := units.get(name))}
    # A first column that is a clock remains the first.
    in_order = sorted(own_names, key=lambda name: own.index(own_names[name]))

    return {name: columns[own_names[name]] for name in in_order}, labels


def _agreed(stated: str, written: str) -> str:
    """Return the unit of a column with its hold; ValueError if the table has another unit."""
    if written in (SINCE_1970, OF_DAY):
        return written
    unit, hold = unit_and_hold(written)
    wanted, wanted_hold = unit_and_hold(stated)
    # Two names of one unit agree, such as deg and °. What is stated decides between two readings.
    in_table = known_unit(unit)
    if in_table and wanted and known_unit(wanted) != in_table:
        raise ValueError(f"its unit is {unit} in the table, not {wanted}: leave the unit out")
    try:
        to_si(wanted or unit)
    except AmbiguousUnitError as error:
        raise ValueError(f"its unit {error}, behind a colon") from None
    except ValueError:
        # A table may have any unit; what a user states is misspelled, if it does not count.
        if misspelled(wanted or unit) or not (is_unit(wanted) or wanted in ("", unit)):
            raise
    return f"{wanted or unit} {wanted_hold or hold}".strip()
