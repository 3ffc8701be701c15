"""Small pieces of HTML for notebooks; all text is escaped, because names come from files."""

from collections.abc import Sequence
from html import escape

from greybox.files.text_table import printable

ROWS = 60  # of a table: a notebook stays readable, and the object has all of them

_CELL = {True: ' style="text-align:left"', False: ' style="text-align:right"'}


def html_text(text: str, element: str = "p") -> str:
    """Return a line of text as an element."""
    return f"<{element}>{_escaped(text)}</{element}>"


def html_list(texts: Sequence[str]) -> str:
    """Return sentences as a list; without sentences, an empty text."""
    return f"<ul>{''.join(html_text(text, 'li') for text in texts)}</ul>" if texts else ""


def html_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)
) -> str:
    """Return `rows` of text under `header` as a table; columns in `left` are flush left."""

    def line(cells: Sequence[str], element: str) -> str:
        columns = (
            f"<{element}{_CELL[k in left]}>{_escaped(cell)}</{element}>"
            for k, cell in enumerate(cells)
        )
        return f"<tr>{''.join(columns)}</tr>"

    hidden = len(rows) - ROWS
    body = [line(row, "td") for row in (rows[:ROWS] if hidden > 0 else rows)]
    if hidden > 0:
        body.append(f'<tr><td colspan="{len(header)}">and {hidden} more</td></tr>')
    return f"<table><thead>{line(header, 'th')}</thead><tbody>{''.join(body)}</tbody></table>"


def _escaped(text: str) -> str:
    # Names come from files, which must not write HTML into a notebook.
    return escape(printable(text, keep="\n"))


class Printed:
    """What a notebook shows as the text that it prints, not as one line."""

    def _repr_html_(self) -> str:
        return html_text(str(self), "pre")
