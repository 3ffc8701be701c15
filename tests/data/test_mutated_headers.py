"""Tables with headers of all kinds at once are read right, or refused with a cure that works."""

import re
import shlex

import numpy as np
import pytest

import greybox as gb

TIME = np.arange(200) / 50
VALUES = 1.5 + np.sin(2.3 * TIME) + 0.3 * TIME

NAMES = [
    "pos",
    "pos[0]",
    "Pos (X)",
    "q(1)",
    "roll rate",
    "v.x",
    "Höhe",
    "gyro/z",
    "α",
    "rate, roll",
]
BRACKETS = ["{} [{}]", "{} ({})", "{} {{{}}}", "{}[{}]", "{} [{} held]", "{} [{}] (raw)", "{} <{}>"]
SCALES = {
    "mm": 1e-3,
    "deg/s": np.pi / 180,
    "m s^-2": 1.0,
    "%": 0.01,
    "rpm": np.pi / 30,
    "mV": 1e-3,
    "counts": 1.0,
    "g": 9.80665,
}
# Units with two readings: what the message lets a user choose, and its value in SI.
CHOICES = {
    "nm": ("N*m", 1.0),
    "MV": ("mV", 1e-3),
    "ms^-1": ("m/s", 1.0),
    "lb": ("lbf", 4.4482216152605),
}
# Names of clocks, their units in a line of units, ticks per second, and their start in ticks.
CLOCKS = [
    ("time", "s", 1.0, 0.0),
    ("t", "s", 1.0, 0.0),
    ("T", "s", 1.0, 0.0),
    ("elapsed_s", "s", 1.0, 3.0),
    ("__time", "s", 1.0, 1.7e9),
    ("timestamp", "us", 1e6, 123e6),
    ("Timestamp", "ms", 1e3, 51e3),
    ("timestamp_sample", "us", 1e6, 5e6),
    ("time_us", "us", 1e6, 7e6),
    ("TimeUS", "us", 1e6, 9e6),
    ("millis", "ms", 1e3, 500.0),
    ("field.header.stamp", "ns", 1e9, 1.7e18),
]
TEXTS = {
    "Time": [f"10:00:{t:06.3f}" for t in TIME],
    "time": [f"2026-05-01T10:00:{t:06.3f}" for t in TIME],
}


class Table:
    """A table with a signal, made by chance, and what a user knows of it."""

    def __init__(self, seed):
        random = np.random.default_rng(seed)
        chance = random.random
        self.separator = str(random.choice([",", ";", "\t"]))
        self.comma = self.separator != "," and chance() < 0.3
        self.style = str(random.choice(["brackets", "line of units", "comment"], p=[0.6, 0.2, 0.2]))
        self.unit = str(random.choice([*SCALES, *CHOICES]))
        bracket = str(random.choice(BRACKETS)) if self.style == "brackets" else BRACKETS[0]
        name = str(random.choice(NAMES))
        self.column = name if self.style == "line of units" else bracket.format(name, self.unit)
        self.is_held = "held" in bracket

        clock, self.tick = self.clock(random)
        columns = [*clock, (self.column, self.unit, self.texts(VALUES))]
        if chance() < 0.2:
            columns += [("a", "m", self.texts(TIME)), ("a", "m", self.texts(-TIME))]
        if chance() < 0.2:
            columns.append(("mode", "", ["hold", "auto"] * (TIME.size // 2)))
        is_quoted = chance() < 0.2
        end = self.separator if chance() < 0.1 else ""

        def line(cells):
            quoted = (
                f'"{cell}"' if is_quoted or self.separator in cell else cell for cell in cells
            )
            return self.separator.join(quoted) + end

        names, units, values = zip(*columns, strict=True)
        has_title = chance() < 0.2 and not self.comma
        above = ["Flight 12, made by logger v2"] if has_title else []
        header = [("# " if self.style == "comment" else "") + line(names)]
        header += [line(units)] if self.style == "line of units" else []
        rows = [line(row) for row in zip(*values, strict=True)]
        if self.style == "brackets" and chance() < 0.1:
            rows.insert(100, header[0])  # as after a restart
        text = str(random.choice(["\n", "\r\n"])).join([*above, *header, *rows, ""])
        self.encoding = str(random.choice(["utf-8", "utf-8-sig", "utf-16"], p=[0.7, 0.2, 0.1]))
        self.bytes = text.encode(self.encoding)

    def texts(self, values, form=".12g"):
        texts = [format(value, form) for value in values]
        return [text.replace(".", ",") for text in texts] if self.comma else texts

    def clock(self, random):
        """Return the columns of the time, with names and units, and the unit that is true."""
        if random.random() < 0.2:
            name = str(random.choice([*TEXTS]))
            return [(name, "", TEXTS[name])], "s"
        if random.random() < 0.15:
            whole, part = np.floor(TIME) + 1.7e9, np.round(TIME % 1 * 1e9)
            texts = [self.texts(x, ".0f") for x in (whole, part)]
            return [("sec", "s", texts[0]), ("nanosec", "ns", texts[1])], "s"
        name, unit, ticks, start = CLOCKS[random.integers(len(CLOCKS))]
        times = start + TIME * ticks
        texts = self.texts(
            np.round(times) if ticks > 1 else times, ".17g" if ticks > 1e6 else ".12g"
        )
        return [(name, unit, texts)], unit


def read_or_cured(path, table):
    """Return the record and the value of the unit in SI; cures are typed as the messages say."""
    columns = {"x": table.column}
    scale = SCALES.get(table.unit)
    for _ in range(3):
        try:
            return gb.read(path, columns=columns)["flight"], scale
        except ValueError as error:
            if clock := re.search(r"columns=(.+?), or 'time \[", str(error)):
                name, _, column = shlex.split(clock[1])[0].partition("=")
                columns[name] = f"{column.rpartition(':')[0]}:{table.tick}"
            elif re.search(r"may be .*: write .*, behind a colon", str(error)):
                unit, scale = CHOICES[table.unit]
                columns["x"] = f"{table.column}:{unit}"
            elif "begin a title above the only one with #" in str(error):
                path.write_text(f"# {table.bytes.decode(table.encoding)}", encoding="utf-8")
            else:
                raise
    raise AssertionError("the cures do not end")


@pytest.mark.parametrize("seed", range(60))
def test_a_table_of_any_look_is_read_right(tmp_path, seed):
    table = Table(seed)
    path = tmp_path / "flight.csv"
    path.write_bytes(table.bytes)
    record, scale = read_or_cured(path, table)
    np.testing.assert_allclose(record.time - record.time[0], TIME, atol=1e-6)
    np.testing.assert_allclose(record["x"], scale * VALUES)
    assert (record.hold.get("x") == np.inf) == table.is_held
