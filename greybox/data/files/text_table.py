"""Tables of text as a person reads them in a terminal."""

from collections.abc import Iterable, Sequence
from textwrap import indent

from greybox.data.files.control_characters import printable
from greybox.data.files.escapes import terminal_text
from greybox.data.files.folded_text import folded


def text_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)
) -> str:
    """Align `rows` of text under `header`; columns in `left` are flush left, others right."""
    # Control characters are written out first: they have no width.
    cells = [[printable(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]

    def line(row: Sequence[str]) -> str:
        parts = (
            c.ljust(w) if k in left else c.rjust(w)
            for k, (c, w) in enumerate(zip(row, widths, strict=True))
        )
        return "  ".join(parts).rstrip()

    rule = "  ".join("-" * w for w in widths)
    return "\n".join([line(cells[0]), rule, *map(line, cells[1:])])


def titled(title: str, lines: Iterable[str]) -> str:
    """Return a title, a blank line, and indented lines, the long ones folded."""
    return folded(terminal_text(f"{title}\n\n" + indent("\n".join(lines), "  ")))
