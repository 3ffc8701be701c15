"""The unit tables of a DataFlash log: UNIT and MULT name units and multipliers by a letter, FMTU uses them."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

from pymavlink.DFReader import MULT_TO_PREFIX

from greybox.logs.readers.ardupilot_metadata import unit
from greybox.logs.readers.dataflash_index import Layout
from greybox.logs.readers.messages import Messages

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
    """Unit of every column of one type, and the column that tells instances apart (empty: none)."""

    columns: Mapping[str, str]
    instance: str


class UnitTables:
    """The tables of one log, made of its UNIT, MULT and FMTU messages."""

    def __init__(self, groups: Iterable[Messages]) -> None:
        self.labels: dict[str, str] = {}
        self._several: dict[str, set[str]] = {}
        self.multipliers: dict[str, float] = {}
        self.letters: dict[int, tuple[str, str]] = {}
        for group in groups:
            if group.name == "UNIT" and "Id" in group.columns and "Label" in group.texts:
                for letter, label in zip(
                    map(_letter, group.columns["Id"]), group.texts["Label"], strict=True
                ):
                    self.labels[letter] = label
                    self._several.setdefault(letter, set()).add(label)
            elif group.name == "MULT" and {"Id", "Mult"} <= group.columns.keys():
                # Single precision on board: pymavlink rounds to 7 digits to look the prefixes up.
                rounded = (float(f"{value:.7g}") for value in group.columns["Mult"])
                self.multipliers.update(
                    zip(map(_letter, group.columns["Id"]), rounded, strict=True)
                )
            elif group.name == "FMTU" and "FmtType" in group.columns and "UnitIds" in group.texts:
                units = group.texts["UnitIds"]
                pairs = zip(units, group.texts.get("MultIds", [""] * len(units)), strict=True)
                self.letters.update(
                    zip(map(_integer, group.columns["FmtType"]), pairs, strict=True)
                )

    @property
    def findings(self) -> tuple[str, ...]:
        """Letters that the table gives several units, in words."""
        return tuple(
            f"the table of units has the letter {letter!r} for {' and for '.join(sorted(labels))}: what has it is "
            "taken without a unit."
            for letter, labels in self._several.items()
            if len(labels) > 1
        )

    def of(self, layout: Layout) -> Units:
        """Units of one type, as pymavlink gives them: a multiplier of the table is part of the unit (cm/s²)."""
        units, scales = self.letters.get(layout.kind, ("", ""))
        columns = {}
        for i, (name, letter) in enumerate(zip(layout.columns, units, strict=False)):
            known = len(self._several.get(letter, ())) == 1
            label = unit(self.labels[letter]) if known else ""
            scaled = label and i < len(scales) and layout.scale(i) is None
            columns[name] = (
                _prefixed(label, self.multipliers.get(scales[i], 1.0)) if scaled else label
            )
        return Units(columns, _instance(layout, units))


def with_usual_units(groups: list[Messages]) -> tuple[list[Messages], tuple[str, ...]]:
    """Give the messages of a log without unit tables the units that ArduPilot has always used, with a finding."""
    if any(unit for group in groups for unit in group.units.values()):
        return list(groups), ()
    names = [group.name for group in groups if group.name in USUAL]
    with_units = [
        replace(g, units={**g.units, **USUAL[g.name]}) if g.name in USUAL else g for g in groups
    ]
    names = ", ".join(dict.fromkeys(names))
    return with_units, (
        (f"the log has no table of units: ArduPilot's usual ones are assumed for {names}.",)
        if names
        else ()
    )


def _prefixed(label: str, multiplier: float) -> str:
    prefix = MULT_TO_PREFIX.get(multiplier)
    return f"{multiplier:.4g} {label}" if prefix is None else prefix + label


def _instance(layout: Layout, units: str) -> str:
    if INSTANCE in units:
        at = units.index(INSTANCE)
        return layout.columns[at] if at < len(layout.columns) else ""
    second = layout.columns[1] if len(layout.columns) > 1 and not units else ""
    return second if second in INSTANCES and layout.format[1] in "bBM" else ""


def _letter(value: float) -> str:
    return chr(_integer(value) & 0x7F)


def _integer(value: float) -> int:
    """Return a number as an integer; 0, which stands for nothing in these tables, for a damaged one."""
    return int(value) if math.isfinite(value) else 0
