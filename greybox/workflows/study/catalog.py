"""Models and problems: the included ones, and those in a user's own file."""

import ast
import importlib
import pkgutil
import re
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from greybox.data.files.spelling import alternatives
from greybox.engine.compiled.compiled_problem import AnyProblem
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.sum import Sum
from greybox.modeling.model import Model, require_known
from greybox.modeling.model_file import models_of, module_from_file
from greybox.workflows.experiment.controller import Controller

Named = TypeVar("Named")
SETTINGS = ("starts", "seed", "method")  # what a problem file may choose


def shipped(kind: str) -> list[str]:
    """Return the names of the included files of a kind, "models" or "problems"."""
    # Modules with a leading underscore are shared by others: they are neither models nor problems.
    package = importlib.import_module(f"greybox.{kind}")
    return sorted(
        item.name
        for item in pkgutil.iter_modules(package.__path__)
        if not item.name.startswith("_")
    )


def shipped_module(kind: str, name: str) -> ModuleType:
    """Import an included file.

    Raises
    ------
    ValueError
        If it does not exist.
    """
    names = shipped(kind)
    if name not in names:
        raise ValueError(
            f"there is no included {kind[:-1]} {name!r}, and a file of your own ends in .py; "
            f"the included ones are {alternatives(name, names)}"
        )
    return importlib.import_module(f"greybox.{kind}.{name}")


def find_problem(text: str) -> tuple[AnyProblem, dict[str, Any]]:
    """Return a problem and its settings.

    `text` is an included name, ``my.py`` (its ``problem()``) or ``my.py:name``.

    Raises
    ------
    ValueError, FileNotFoundError
        If it does not exist or is not a problem.
    """
    module, name = _locate("problems", text)
    place = text.removesuffix(f":{name}")
    attribute = name or "problem"
    problem = getattr(module, attribute, None)
    if problem is None:
        models = [f", or give model={place}:{m.__name__} data=FILE" for m in models_of(module)]
        raise ValueError(
            f"{place} has no {attribute!r}: define {attribute}() that returns a gb.Problem"
            f"{''.join(models[:1])}."
        )
    if callable(problem):
        problem = problem()
    if not isinstance(problem, Problem | Sum):
        raise ValueError(
            f"{attribute} in {place} is {problem!r:.60}: it must be, or return, a gb.Problem or a "
            "sum of them."
        )

    # The stem names files and figures, whatever the problem calls itself.
    label = Path(place).stem + (f":{name}" if name else "")
    settings = getattr(module, "settings", {})
    require_known(settings, SETTINGS, "setting", f"a problem such as {text}")
    return problem.with_(name=label), dict(settings)


def find_model(text: str) -> Model:
    """Return a model from ``tilt:Tilt``, ``polynomial:Polynomial(4, 1)`` or ``my.py:Class``.

    The class may be left out if it is the only model of the file.

    Raises
    ------
    ValueError, FileNotFoundError
        If it does not exist or is not a model.
    """
    match = re.fullmatch(r"(?P<place>[^()]+?)(\((?P<arguments>.*)\))?", text)
    if match is None:
        raise ValueError(
            f"model {text!r} is not understood: write file:Class, e.g. tilt:Tilt or my.py:MyModel."
        )

    module, name = _locate("models", match["place"])
    models = {model.__name__: model for model in models_of(module)}
    model = _named(name, models, f"there is no model {text!r}; {match['place'].split(':')[0]} has")
    try:
        # The arguments are literals: nothing of what a user pastes here is executed.
        arguments = ast.literal_eval(f"[{match['arguments'] or ''}]")
    except (SyntaxError, ValueError):
        raise ValueError(
            f"the arguments in model {text!r} are not understood: write plain values, e.g. (4, 1)."
        ) from None
    return model(*arguments)


def find_controller(text: str) -> type[Controller]:
    """Return a class of controllers from ``controller:AttitudeController`` or ``my.py:Class``.

    Raises
    ------
    ValueError, FileNotFoundError
        If it does not exist or is not a controller.
    """
    module, name = _locate("models", text)
    controllers = {
        key: value
        for key, value in vars(module).items()
        if isinstance(value, type) and issubclass(value, Controller) and value is not Controller
    }
    return _named(
        name, controllers, f"there is no controller {text!r}; {text.partition(':')[0]} has"
    )


def _named(name: str, classes: Mapping[str, type[Named]], refusal: str) -> type[Named]:
    """Return the class of this name, or the only class if there is no name."""
    # Most files have one class, whose name need not be repeated.
    if not name and len(classes) == 1:
        (name,) = classes
    if name not in classes:
        raise ValueError(f"{refusal} {alternatives(name, classes)}")
    return classes[name]


def _locate(kind: str, text: str) -> tuple[ModuleType, str]:
    """Split ``file:name`` and import the file."""
    # Not simply at the first colon: on Windows a drive letter has one too.
    match = re.fullmatch(r"(.+\.py)(?::(\w+))?", text)
    if match:
        return module_from_file(match[1]), match[2] or ""
    place, _, name = text.partition(":")
    return shipped_module(kind, place), name
