"""Control characters in names and texts, written out."""

import unicodedata
from typing import Any

from greybox.data.files.normalization import normalize

# Control characters (a terminal obeys them), formatting ones (they can reverse the order of what
# follows), halves of characters (no terminal takes them), line and paragraph separators.
CONTROLS = ("Cc", "Cf", "Cs", "Zl", "Zp")


def printable(text: str, keep: str = "") -> str:
    r"""Return a text with its control characters written out, as ``\x1b``, except those in `keep`.

    Every name and text that comes from a file passes through here before it is printed.
    """
    if text.isprintable():
        return text
    return "".join(
        c
        if c in keep or unicodedata.category(c) not in CONTROLS
        else c.encode("unicode_escape", "surrogatepass").decode("ascii")
        for c in text
    )


def all_printable(thing: Any) -> Any:
    """Return names and texts, at any depth, with control characters written out."""
    if isinstance(thing, str):
        return printable(thing)
    if isinstance(thing, dict):
        return {all_printable(name): all_printable(value) for name, value in thing.items()}
    if type(thing) in (tuple, list):
        return type(thing)(all_printable(item) for item in thing)
    return thing


def write_out(target: Any, *names: str) -> None:
    """Write out control characters in these attributes of a new object, at any depth."""
    for name in names:
        normalize(target, **{name: all_printable(getattr(target, name))})
