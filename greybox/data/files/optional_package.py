"""Optional packages, imported when a function first needs them."""

from importlib import import_module
from typing import Any


def required(package: str, extra: str, what: str) -> Any:
    """Return an optional package.

    Parameters
    ----------
    package : str
        Name of the module.
    extra : str
        The extra of greybox that installs it.
    what : str
        What needs it: the subject of the message.

    Raises
    ------
    ModuleNotFoundError
        If it is not installed; the message names the extra.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        # The package itself is installed, and lacks a module that it needs.
        if error.name != package.partition(".")[0]:
            raise
        cure = f"pip install 'greybox-id[{extra}]'"
        raise ModuleNotFoundError(f"{what} needs {package}: {cure}.", name=error.name) from None
