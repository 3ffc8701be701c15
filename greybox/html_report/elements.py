"""Elements of the page: the tree of the standard library, which escapes texts and attributes."""

from collections.abc import Iterable
from typing import Any
from xml.etree.ElementTree import Element, tostring

from greybox.files.text_table import printable

Child = Element | str | None | Iterable["Child"]
"""Content of an element: elements, text, nothing, or several of these."""


def tag(name: str, *children: Child, **attributes: Any) -> Element:
    """Return an element. Attributes that are None or False are left out.

    In names of attributes hyphens replace underscores; one at the end, as in ``class_``, is left
    out.
    """
    # Texts come from files of strangers. The tree escapes markup, and `printable` the control
    # characters that HTML does not allow.
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
        text = printable(children, keep="\n\t")
        # This tree keeps a text in the element before it.
        if len(element):
            element[-1].tail = (element[-1].tail or "") + text
        else:
            element.text = (element.text or "") + text
    elif isinstance(children, Element):
        element.append(children)
    else:
        for child in children:
            _append(element, child)
