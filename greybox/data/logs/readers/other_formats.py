"""Files of other kinds, which greybox does not read, and what makes a table of them."""

from pathlib import Path
from typing import NamedTuple


class OtherFormat(NamedTuple):
    """A kind of file, the first bytes that show it, and the command that makes a table of it."""

    starts: tuple[bytes, ...]
    name: str
    cure: str


BY_PANDAS = "make a table of it, pandas.{}.to_csv('table.csv', index=False)"
BY_PLOTJUGGLER = "save the topics of the test as CSV, as PlotJuggler does"

# The members of an archive decide what made it.
ZIP_MEMBERS = (
    (b"[Content_Types].xml", "a spreadsheet", BY_PANDAS.format("read_excel({file!r})")),
    (b".npy", "arrays of numpy", BY_PANDAS.format("DataFrame(dict(numpy.load({file!r})))")),
    (b"", "a zip archive", "unpack it, unzip {file}"),
)

OTHER_FORMATS = (
    OtherFormat((b"\x1f\x8b",), "a gzip archive", "unpack it, gunzip {file}"),
    OtherFormat((b"\xfd7zXZ",), "an xz archive", "unpack it, unxz {file}"),
    OtherFormat((b"BZh",), "a bzip2 archive", "unpack it, bunzip2 {file}"),
    OtherFormat((b"(\xb5/\xfd",), "a zstd archive", "unpack it, unzstd {file}"),
    OtherFormat(
        (b"{", b"[{", b"[["), "JSON", BY_PANDAS.format("read_json({file!r}, lines={lines})")
    ),
    OtherFormat((b"PAR1",), "a Parquet table", BY_PANDAS.format("read_parquet({file!r})")),
    OtherFormat((b"ARROW1",), "a Feather table", BY_PANDAS.format("read_feather({file!r})")),
    OtherFormat(
        (b"\x93NUMPY",), "an array of numpy", BY_PANDAS.format("DataFrame(numpy.load({file!r}))")
    ),
    OtherFormat((b"#ROSBAG", b"\x89MCAP", b"SQLite format 3"), "a ROS bag", BY_PLOTJUGGLER),
    OtherFormat((b"%PDF",), "a PDF", "save its table as CSV"),
    OtherFormat((b"\x89PNG",), "a PNG image", "save the numbers that it shows as CSV"),
)


def other_format(path: Path, head: bytes) -> str:
    """Return what a file is and what to do with it, by its first bytes; "" for other files."""
    start = head.lstrip()
    if head.startswith(b"PK"):
        kind, cure = next((name, cure) for sign, name, cure in ZIP_MEMBERS if sign in head)
    else:
        other = next((o for o in OTHER_FORMATS if start.startswith(o.starts)), None)
        if other is None:
            return ""
        kind, cure = other.name, other.cure
    # An object in every line, or one for the file.
    lines = b"\n{" in start
    return f"is {kind}, which greybox does not read: {cure.format(file=path.name, lines=lines)}."
