"""Packages that greybox works without, but for what they are for: imported when first asked for."""

from importlib import import_module
from typing import Any


def required(package: str, extra: str, what: str) -> Any:
    """Return an optional package.

    Parameters
    ----------
    package : str
        To be imported.
    extra : str
        Of greybox, which installs it.
    what : str
        Needs it: the subject of the sentence.

    Raises
    ------
    ModuleNotFoundError
        If it is not installed; the sentence names the extra.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        if (
            error.name != package.partition(".")[0]
        ):  # which is installed, and lacks something of its own
            raise
        cure = f"pip install 'greybox-id[{extra}]'"
        raise ModuleNotFoundError(f"{what} needs {package}: {cure}.", name=error.name) from None
