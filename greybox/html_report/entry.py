"""One result on a page."""

from dataclasses import dataclass

from greybox.estimate.result import Fit


@dataclass(frozen=True, eq=False)
class Entry:
    """One result on the page.

    Attributes
    ----------
    label : str
        What it is called on the page.
    fit : Fit or None
        None where there is none, for the reason in `error`.
    file : str
        Where it was read.
    error : str
    command : tuple of str
        The arguments of the command ``greybox`` that made it, with others.
    anchor : str
        Of its section; empty where it has none.
    """

    label: str
    fit: Fit | None
    file: str = ""
    error: str = ""
    command: tuple[str, ...] = ()
    anchor: str = ""
