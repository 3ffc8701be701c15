"""Values that print themselves, in a terminal and in a notebook."""

from html import escape

from greybox.data.files.control_characters import printable
from greybox.data.files.escapes import html_text


def one_line(value: object, *facts: str) -> str:
    """Return ``<Class fact, fact>`` for the `repr` of a value, in less than 120 characters."""
    text = printable(" ".join(f"<{type(value).__name__} {', '.join(facts)}".split()))
    return f"{text}>" if len(text) < 119 else f"{text[:115]}...>"


def preformatted(text: str) -> str:
    """Return lines of text as HTML."""
    # Names come from files, which must not write HTML into a notebook.
    return f"<pre>{escape(html_text(text))}</pre>"


class Printed:
    """A value that a notebook shows as its printed text; its `repr` is the first line of it."""

    def __repr__(self) -> str:
        return one_line(self, str(self).partition("\n")[0])

    def _repr_html_(self) -> str:
        return preformatted(str(self))
