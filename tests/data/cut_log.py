"""Cut a piece out of a DataFlash log (.BIN), by time and message names, into a smaller .BIN.

python tests/data/cut_log.py IN.BIN OUT.BIN --from 60 --to 70 --messages ATT RATE XKF1 [--every 2]

The messages that describe the log and the vehicle (FMT, UNIT, MULT, FMTU, PARM, VER, and the texts,
modes and events of all times) are kept whole, the others as they are or left out; ``--every N``
keeps each Nth of every type and instance. ``--parameters`` keeps only the parameters whose names
start so.
"""

import argparse
from pathlib import Path

import numpy as np

from greybox.data.logs.readers.dataflash_index import index, text
from greybox.data.logs.readers.dataflash_layout import Layout

ABOUT = ("FMT", "UNIT", "MULT", "FMTU", "VER", "MSG", "MODE", "EV", "ARM")


def cut(data, start, end, names, every=1, parameters=("",)):
    """Return the bytes of the piece from `start` to `end`, s."""
    found = index(data)
    kept = []
    for i, layout in enumerate(found.layouts):
        offsets = found.offsets[found.numbers == i]
        if layout.name == "PARM":
            offsets = [
                at for at in offsets if _parameter(data, at, layout).startswith(tuple(parameters))
            ]
        elif layout.name not in ABOUT:
            offsets = (
                _chosen(data, offsets, layout, start, end, every) if layout.name in names else []
            )
        kept += [(int(at), layout.length) for at in offsets]
    return b"".join(data[at : at + length] for at, length in sorted(kept))


def _chosen(data, offsets, layout, start, end, every):
    """Offsets of the messages of one type between two times; each Nth of every value of the byte after the time."""
    times = np.array([int.from_bytes(data[at + 3 : at + 11], "little") / 1e6 for at in offsets])
    inside = offsets[(times >= start) & (times <= end)]
    lanes = {}
    for at in inside.tolist():
        lanes.setdefault(data[at + 11] if layout.format[1] == "B" else 0, []).append(at)
    return [at for lane in lanes.values() for at in lane[::every]]


def _parameter(data, at, layout: Layout):
    column = layout.columns.index("Name")
    begin = at + 3 + layout.dtype.fields[f"f{column}"][1]
    return text(bytes(data[begin : begin + 16]))


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", type=Path)
    parser.add_argument("target", type=Path)
    parser.add_argument("--from", dest="start", type=float, default=0, help="s on the log's clock")
    parser.add_argument("--to", dest="end", type=float, default=float("inf"), help="s")
    parser.add_argument("--messages", nargs="+", default=["ATT", "RATE"])
    parser.add_argument("--every", type=int, default=1, help="keep each Nth")
    parser.add_argument(
        "--parameters", nargs="+", default=[""], help="beginnings of parameter names to keep"
    )
    options = parser.parse_args()
    piece = cut(
        options.source.read_bytes(),
        options.start,
        options.end,
        options.messages,
        options.every,
        options.parameters,
    )
    options.target.write_bytes(piece)
    print(f"{options.target}: {len(piece)} bytes")  # noqa: T201


if __name__ == "__main__":
    main()
