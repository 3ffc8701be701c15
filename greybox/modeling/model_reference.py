"""How a stored result names its model: module, class and arguments, as plain JSON."""

import importlib
import inspect
import sys
from collections.abc import Callable
from typing import Any

from greybox.modeling.model import Model


def reference(model: Model) -> dict[str, Any]:
    """Return ``{"class": "module:Class", "arguments": [...], "keywords": {...}}``, with models inside it likewise."""
    positional, named = model.arguments
    return {
        "class": f"{type(model).__module__}:{type(model).__qualname__}",
        "arguments": [_plain(value) for value in positional],
        "keywords": {name: _plain(value) for name, value in named.items()},
    }


def resolve(stored: dict[str, Any]) -> Model:
    """Import the model that a reference names.

    Raises
    ------
    LookupError
        When its module or class is not there, or is no model; the sentence says what is missing.
    """
    module_name, class_name = stored["class"].split(":")
    missing = f"the model {class_name} of the module {module_name!r} is needed and was not found"
    cure = "import it first, put its file where Python finds it, or give the model itself, model=..."
    try:
        owner: Any = sys.modules.get(module_name) or importlib.import_module(module_name)
        for part in class_name.split("."):
            owner = getattr(owner, part)
    except (ImportError, AttributeError) as error:
        raise LookupError(f"{missing} ({error}): {cure}.") from None
    if not (isinstance(owner, type) and issubclass(owner, Model)):
        raise LookupError(f"{missing} (its {class_name} is not a Model): {cure}.")
    arguments = [_alive(value) for value in stored["arguments"]]
    try:
        return owner(*arguments, **{name: _alive(value) for name, value in stored["keywords"].items()})
    except TypeError as error:
        raise LookupError(f"{missing} as it was: {error}; give the model itself, model=...") from None


def source_text(function: Callable[..., Any]) -> str:
    """Return the source of a tie or constraint, for the record; its name where the source is not at hand."""
    try:
        return inspect.getsource(function).strip()
    except (OSError, TypeError):
        return repr(function)


def _plain(value: Any) -> Any:
    if isinstance(value, Model):
        return {"model": reference(value)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return {"text": repr(value)}


def _alive(value: Any) -> Any:
    if isinstance(value, dict) and "model" in value:
        return resolve(value["model"])
    if isinstance(value, dict):
        raise LookupError(
            f"an argument of the model, {value.get('text')}, was stored as text only: give model=... itself."
        )
    return tuple(_alive(item) for item in value) if isinstance(value, list) else value
