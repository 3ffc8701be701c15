"""How a stored result names its model: module, class and arguments, as plain JSON."""

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Sequence
from typing import Any

from greybox.files.arrays import Fields, Named
from greybox.files.escapes import printable
from greybox.modeling.colored_disturbance import ColoredDisturbance
from greybox.modeling.known_systems import KnownStateSpace, KnownTransferFunction
from greybox.modeling.model import AnyModel, Model, class_of
from greybox.modeling.model_file import models_of
from greybox.modeling.transfer_function import FeedbackLoop, RenamedParameters, SeriesConnection


def reference(model: Model) -> Fields:
    """Return ``{"class": "module:Class", "arguments": [...], "keywords": {...}}`` and names."""
    positional, named = model.arguments
    return {
        "class": f"{type(model).__module__}:{type(model).__qualname__}",
        "arguments": [_plain(value) for value in positional],
        "keywords": {name: _plain(value) for name, value in named.items()},
        "parameters": [*model.parameters],
    }


def resolve(stored: Named, given: Sequence[AnyModel] = ()) -> Model:
    """Return the model that a reference names: one of those `given`, or one of greybox's own.

    A reference comes from a file, and a file must not choose what is imported: only `given` models
    and those that greybox includes are considered, whatever else is installed or loaded.

    Raises
    ------
    LookupError
        If it is neither, or does not take the stored arguments.
    ValueError
        If it has other parameters.
    """
    module_name, _, class_name = stored["class"].partition(":")
    missing = (
        f"the model {printable(class_name)} of the module {module_name!r} is needed and was not "
        "found"
    )
    named = [model for model in given if class_of(model).__qualname__ == class_name]
    # The same file has the module ``__main__`` when it is run.
    named.sort(key=lambda model: class_of(model).__module__ != module_name)
    model = named[0] if named else included_model(module_name, class_name)
    if model is None:
        names = ", ".join(class_of(model).__qualname__ for model in given) or "none"
        raise LookupError(
            f"{missing} among those of greybox or those given ({names}): give its class or file, "
            "gb.load(path, models=[...])."
        )

    try:
        if not isinstance(model, Model):
            arguments = [_alive(value, given) for value in stored["arguments"]]
            keywords = {name: _alive(value, given) for name, value in stored["keywords"].items()}
            model = model(*arguments, **keywords)
        # Files of earlier versions do not name the parameters.
        different = {*stored.get("parameters", model.parameters)} ^ {*model.parameters}
    # A crafted file may nest models without end, or give them any arguments.
    except (TypeError, ValueError, ArithmeticError, RecursionError) as error:
        raise LookupError(
            f"{missing} as it was: {error}; give the model itself, gb.load(path, models=[...])"
        ) from None
    if different:
        raise ValueError(
            f"the model {printable(class_name)} and the fitted one differ in their parameters "
            f"({printable(', '.join(sorted(map(str, different))))}): give the fitted one, "
            "gb.load(path, models=[...])."
        )
    return model


def included_model(module_name: str, class_name: str) -> type[Model] | None:
    """Return the class of an included model, of a connection or of a system of known numbers."""
    models: list[type[Model]] = [
        SeriesConnection,
        RenamedParameters,
        FeedbackLoop,
        KnownTransferFunction,
        KnownStateSpace,
        ColoredDisturbance,
    ]
    # By name, since models come after modeling; only modules of this package are imported.
    package = importlib.import_module("greybox.models")
    included = {f"greybox.models.{item.name}" for item in pkgutil.iter_modules(package.__path__)}
    if module_name in included:
        models += models_of(importlib.import_module(module_name))
    place = module_name, class_name
    return next((m for m in models if (m.__module__, m.__qualname__) == place), None)


def source_text(function: Callable[..., Any]) -> str:
    """Return the source of a tie or constraint, or its name where there is no source."""
    try:
        return inspect.getsource(function).strip()
    except (OSError, TypeError):
        return repr(function)


def _plain(value: Any) -> Any:
    if isinstance(value, Model):
        return {"model": reference(value)}
    if isinstance(value, int | float | str | None):
        return value
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return {"text": repr(value)}


def _alive(value: Any, given: Sequence[AnyModel]) -> Any:
    if isinstance(value, dict) and "model" in value:
        return resolve(value["model"], given)
    if isinstance(value, dict):
        text = printable(str(value.get("text")))
        raise LookupError(
            f"an argument of the model, {text}, was stored as text only: give model=... itself."
        )
    return tuple(_alive(item, given) for item in value) if isinstance(value, list) else value
