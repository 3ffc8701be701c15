"""Units of a DataFlash log: UNIT and MULT name them by a letter, and FMTU uses the letters."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from pymavlink.DFReader import MULT_TO_PREFIX

from greybox.data.files.grouping import unique
from greybox.data.logs.readers.ardupilot_metadata import column, unit
from greybox.data.logs.readers.dataflash_layout import Layout
from greybox.data.logs.readers.messages import Messages

INSTANCE = "#"  # the letter of a column that counts instances
INSTANCES = ("I", "C", "Inst", "Instance")  # names of such a second column in logs without FMTU

_ANGLES = dict.fromkeys("DesRoll Roll DesPitch Pitch DesYaw Yaw ErrRP ErrYaw".split(), "deg")
_VELOCITY = dict.fromkeys(("VN", "VE", "VD"), "m/s") | dict.fromkeys(("PN", "PE", "PD"), "m")
USUAL = {
    "ATT": _ANGLES,
    "AHR2": _ANGLES,
    "RATE": dict.fromkeys("RDes R PDes P YDes Y".split(), "deg/s"),
    "IMU": dict.fromkeys("GyrX GyrY GyrZ".split(), "rad/s")
    | dict.fromkeys("AccX AccY AccZ".split(), "m/s²"),
    **dict.fromkeys(("EKF1", "NKF1", "XKF1"), _ANGLES | _VELOCITY),
}


class Units(NamedTuple):
    """Unit of every column of one type, and the column of instances, if any."""

    columns: Mapping[str, str]
    instance: str


class UnitTables:
    """The tables of one log, made of its UNIT, MULT and FMTU messages."""

    def __init__(self, groups: Iterable[Messages]) -> None:
        tables = {group.name: group for group in groups}
        self._labels: dict[str, set[str]] = {}
        for letter, label in _pairs(tables.get("UNIT"), "Label"):
            self._labels.setdefault(_letter(letter), set()).add(label)
        # Single precision on board: pymavlink rounds to 7 digits to look the prefixes up.
        self._multipliers = {
            _letter(letter): float(f"{value:.7g}")
            for letter, value in _pairs(tables.get("MULT"), "Mult")
        }
        used = tables.get("FMTU")
        letters = zip(column(used, "UnitIds"), column(used, "MultIds"), strict=False)
        self._letters = dict(zip(map(_integer, column(used, "FmtType")), letters, strict=False))

    @property
    def findings(self) -> tuple[str, ...]:
        """Messages about letters with several units in the table."""
        return tuple(
            f"the table of units has the letter {letter!r} for {' and for '.join(sorted(labels))}: "
            "its columns are taken without a unit."
            for letter, labels in self._labels.items()
            if len(labels) > 1
        )

    def of(self, layout: Layout) -> Units:
        """Return the units of one type as pymavlink does, with the multiplier in it, cm/s²."""
        units, scales = self._letters.get(layout.kind, ("", ""))
        columns = {}
        for i, (name, letter) in enumerate(zip(layout.columns, units, strict=False)):
            labels = self._labels.get(letter, ())
            label = unit(*labels) if len(labels) == 1 else ""
            # A format letter that scales has been applied to the numbers already.
            scaled = label and i < len(scales) and layout.scale(i) is None
            multiplier = self._multipliers.get(scales[i], 1.0) if scaled else 1.0
            # The prefix of 1.0 is empty.
            columns[name] = MULT_TO_PREFIX.get(multiplier, f"{multiplier:.4g} ") + label
        return Units(columns, _instance(layout, units))


def with_usual_units(groups: list[Messages]) -> tuple[list[Messages], tuple[str, ...]]:
    """Give messages of logs without unit tables ArduPilot's usual units, with a finding."""
    if any(unit for group in groups for unit in group.units.values()):
        return groups, ()
    names = ", ".join(unique(group.name for group in groups if group.name in USUAL))
    with_units = [replace(g, units={**g.units, **USUAL.get(g.name, {})}) for g in groups]
    text = f"the log has no table of units: ArduPilot's usual ones are assumed for {names}."
    return with_units, (text,) if names else ()


def _pairs(table: Messages | None, value: str) -> Iterable[tuple[float, Any]]:
    """Return the pairs of the columns Id and `value`; empty if one is missing."""
    return zip(column(table, "Id"), column(table, value), strict=False)


def _instance(layout: Layout, units: str) -> str:
    if INSTANCE in units:
        at = units.index(INSTANCE)
        return layout.columns[at] if at < len(layout.columns) else ""
    second = layout.columns[1] if len(layout.columns) > 1 and not units else ""
    return second if second in INSTANCES and layout.format[1] in "bBM" else ""


def _letter(value: float) -> str:
    # Letters are logged as numbers; damaged ones may exceed ASCII.
    return chr(_integer(value) & 0x7F)


def _integer(value: float) -> int:
    """Return a number as an integer; 0, which these tables do not use, for a damaged one."""
    return int(value) if math.isfinite(value) else 0
