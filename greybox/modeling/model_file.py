"""Models in files: a user's own Python file as a module, and the models that a module defines."""

import importlib.util
import inspect
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from greybox.data.files.safe_files import require_file
from greybox.modeling.model import Model


def module_from_file(path: str | Path) -> ModuleType:
    """Import a user's own file under its own name, as Python does from the working directory.

    Raises
    ------
    OSError
        If it is not a file; FileNotFoundError if it does not exist.
    ValueError
        If it has the name of another module.
    """
    path = require_file(path)
    # The file may import its neighbors.
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.insert(0, folder)

    loaded = sys.modules.get(path.stem)
    if (
        loaded is not None
        and Path(getattr(loaded, "__file__", "") or "").resolve() == path.resolve()
    ):
        return loaded
    # A second module of this name would replace the first one everywhere.
    if loaded is not None or path.stem in sys.stdlib_module_names:
        raise ValueError(
            f"{path} has the name of another Python module, {path.stem!r}: rename the file."
        )

    spec: Any = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look up their module by name while it runs, so it is registered before.
    sys.modules[path.stem] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        # A module that failed halfway must not satisfy the next import.
        del sys.modules[path.stem]
        raise

    for value in vars(module).values():
        # A class that a call of `type` made has the module of its metaclass.
        if isinstance(value, type) and issubclass(value, Model) and value.__module__ == "abc":
            value.__module__ = module.__name__
    return module


def models_of(module: ModuleType) -> list[type[Model]]:
    """Return the concrete model classes that a module defines."""
    return [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Model)
        and value.__module__ == module.__name__
        and not inspect.isabstract(value)
    ]
