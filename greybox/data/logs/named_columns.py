"""Columns of a table under the user's names, and signals in SI."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

from greybox.data.files.arrays import Array
from greybox.data.intersample import CONTINUOUS, HELD
from greybox.data.record import Record
from greybox.data.response_columns import find_column
from greybox.data.time_column import unit_in_name
from greybox.data.units import to_si

BETWEEN = {"held": HELD, "sampled": CONTINUOUS}  # ends a unit, see `table_columns.table`


def renamed(
    columns: Mapping[str, Array], units: Mapping[str, str], stated: Mapping[str, str], source: str
) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the columns of a table in its order, the stated ones under their new names, and units.

    Raises
    ------
    ValueError
        If a column does not exist, its unit is not known, or the table has it in another unit.
    """
    # The header as in the file: messages quote it, and users may write names with their brackets.
    header = [f"{name} [{unit}]" if (unit := units.get(name)) else name for name in columns]
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
            unit = f"{unit or unit_in_name(own[place])} {hold}".strip()
            labels[name] = _agreed(unit, units.get(own[place], ""))
        except ValueError as error:
            sentence = str(error)
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
    unit, hold = unit_and_hold(written)
    wanted, wanted_hold = unit_and_hold(stated)
    # Two names of one unit agree, such as deg and °.
    if unit and wanted and to_si(wanted) != to_si(unit):
        raise ValueError(f"its unit is {unit} in the table, not {wanted}: leave the unit out")
    to_si(wanted or unit)
    return f"{wanted or unit} {wanted_hold or hold}".strip()


def unit_and_hold(text: str) -> tuple[str, str]:
    """Split ``deg sampled``, a unit and a word on the hold; either may be empty."""
    unit, _, hold = text.strip().rpartition(" ")
    hold = hold.lower()
    return (unit, hold) if hold in BETWEEN else (text, "")


def in_si(record: Record, names: Iterable[str]) -> Record:
    """Return a record with these signals in SI; units that are not known become findings."""
    signals = dict(record.signals)
    units = dict(record.units)
    findings = [*record.findings]
    for name in names:
        unit = record.units.get(name, "")
        try:
            conversion = to_si(unit)
        except ValueError as error:
            findings.append(f"{name} was taken as it is, in {unit!r}: {error}.")
            continue
        signals[name] = conversion.apply(record[name])
        units[name] = conversion.si
        findings += [f"{name}: {conversion.remark}."] if conversion.remark else []

    return replace(record, signals=signals, units=units, findings=tuple(findings))
