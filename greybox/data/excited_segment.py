"""One excited segment of an experiment, and a table of segments."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from greybox.data.files.argument_checks import checked_items
from greybox.data.files.arrays import Interval
from greybox.data.files.normalization import normalize
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import one_line
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table

KINDS = ("sine", "sweep", "multisine", "noise", "step", "manoeuvre")


@public
@dataclass(frozen=True)
class Segment:
    """One excited segment of an experiment: a sine, a sweep, a multisine, noise or a manoeuvre.

    Parameters
    ----------
    start, end : float, s
        On the record's clock.
    kind : "sine", "sweep", "multisine", "noise", "step" or "manoeuvre"
    axis : str
        The axis as named in the log, or the name of the setpoint.
    omega : float, rad/s
        Frequency of a sine; NaN otherwise.
    band : (low, high), rad/s
        Frequencies covered; for a sine, both are `omega`.
    amplitude, offset : float
        Amplitude of the excitation, and its operating point, in `unit` (that of the log); NaN if
        unknown.
    source : str
        How it was detected: "SIDS", the announcing message, "setpoint ..." or "injected ...".
    usable : bool
        False for a test that cannot be used; `findings` (tuple of str) says why.

    Raises
    ------
    ValueError
        If the end is not after the start, or the kind is unknown.
    """

    start: float
    end: float
    kind: str = "sine"
    axis: str = ""
    omega: float = math.nan
    band: Interval = (math.nan, math.nan)
    amplitude: float = math.nan
    offset: float = math.nan
    unit: str = ""
    source: str = ""
    usable: bool = True
    findings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the values; a sine's band is its frequency."""
        if not self.end > self.start:
            raise ValueError(
                f"the segment ends at {self.end:g} s, not after its start at {self.start:g} s."
            )
        if self.kind not in KINDS:
            raise ValueError(
                f"the kind of a segment is {self.kind!r}: it must be one of {', '.join(KINDS)}."
            )
        if self.kind == "sine" and math.isnan(self.band[0]):
            normalize(self, band=(self.omega, self.omega))

    @property
    def duration(self) -> float:
        """From start to end, s."""
        return self.end - self.start

    @property
    def periods(self) -> float:
        """Duration in periods of the lowest frequency."""
        return self.duration * self.band[0] / math.tau

    def refused(self, *findings: str) -> "Segment":
        """Return the segment as not usable, with more findings."""
        return replace(self, usable=False, findings=(*self.findings, *findings))

    def __repr__(self) -> str:
        return one_line(
            self,
            self.kind,
            f"{self.start:.6g} to {self.end:.6g} s",
            self.axis or "no axis",
            *([] if self.usable else ["not usable"]),
        )


Segments = Sequence[Segment]


@public
def segment_table(segments: Segments) -> str:
    """Return the segments as a table for a terminal, with their findings below it."""
    header = (
        "",
        "start s",
        "end s",
        "kind",
        "axis",
        "rad/s",
        "periods",
        "amplitude",
        "offset",
        "usable",
        "source",
    )
    rows = []
    for k, s in enumerate(segments, start=1):
        band = (
            number(s.omega)
            if s.kind == "sine"
            else f"{number(s.band[0], 3)} to {number(s.band[1], 3)}"
        )
        # The periods of a sweep's lowest frequency say little about the sweep.
        periods = number(s.periods, 3) if s.kind == "sine" else "-"
        times = (f"{s.start:.2f}", f"{s.end:.2f}", s.kind, s.axis, band, periods)
        sizes = (f"{number(s.amplitude, 3)} {s.unit}".rstrip(), number(round(s.offset, 9), 3))
        rows.append((str(k), *times, *sizes, "yes" if s.usable else "no", s.source))
    if not rows:
        return "no excited segment was found"
    # Findings are sentences, too long for a column.
    notes = [f"{k}: {text}" for k, s in enumerate(segments, start=1) for text in s.findings]
    # The tests of one flight often have one axis and one source.
    columns: dict[str, Sequence[str]] = dict(zip(header, zip(*rows, strict=True), strict=True))
    common = [name for name in ("axis", "source") if len({*columns[name]}) == 1 < len(rows)]
    said = [f"{name} {columns[name][0]}" for name in common if columns[name][0]]
    notes += [f"all: {', '.join(said)}"] if said else []
    shown = {name: column for name, column in columns.items() if name not in common}
    left = [k for k, name in enumerate(shown) if name in ("kind", "axis", "source")]
    return "\n".join([text_table([*shown], [*zip(*shown.values(), strict=True)], left), *notes])


def checked_segments(segments: Iterable[Segment]) -> tuple[Segment, ...]:
    """Return the segments; TypeError for anything else, such as the parts of an `Excitation`."""
    return checked_items(
        "a segment",
        segments,
        Segment,
        "those of gb.logs.find_segments, or gb.data.Segment(start, end)",
    )
