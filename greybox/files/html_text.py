"""How notebooks show values that print themselves."""

from html import escape

from greybox.files.text_table import printable


def preformatted(text: str) -> str:
    """Return lines of text as HTML."""
    # Names come from files, which must not write HTML into a notebook.
    escaped = escape(printable(text, keep="\n"))
    return f"<pre>{escaped}</pre>"


class Printed:
    """A value that a notebook shows as its printed text, not as one line."""

    def _repr_html_(self) -> str:
        return preformatted(str(self))
