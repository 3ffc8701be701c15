"""Elements of the page: a tree of the standard library, which escapes every text and attribute that it writes."""

from collections.abc import Iterable
from typing import Any
from xml.etree.ElementTree import Element, tostring

from greybox.files.text_table import printable

Child = Element | str | None | Iterable["Child"]
"""What stands in an element: elements, text, nothing, or several of these."""


def tag(name: str, *children: Child, **attributes: Any) -> Element:
    """Return an element; of an attribute that is None or False nothing is written, of True its name.

    Names of attributes are written with hyphens for underscores, and without one at the end:
    ``class_``.
    """
    element = Element(name)
    for key, value in attributes.items():
        if value is not None and value is not False:
            text = "" if value is True else str(value)
            element.set(key.rstrip("_").replace("_", "-"), printable(text, keep="\n\t"))
    _append(element, children)
    return element


def html(element: Element) -> str:
    """Return an element as HTML."""
    return tostring(element, encoding="unicode", method="html")


def _append(element: Element, children: Child) -> None:
    if children is None:
        return
    if isinstance(children, str):
        _append_text(element, printable(children, keep="\n\t"))
    elif isinstance(children, Element):
        element.append(children)
    else:
        for child in children:
            _append(element, child)


def _append_text(element: Element, text: str) -> None:
    """Append text after what is there: this tree keeps it at the element before it."""
    if len(element):
        element[-1].tail = (element[-1].tail or "") + text
    else:
        element.text = (element.text or "") + text
