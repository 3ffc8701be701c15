"""How a stored result names its model: module, class and arguments, as plain JSON."""

import importlib
import inspect
import pkgutil
import warnings
import zlib
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from greybox.data.files.control_characters import printable
from greybox.data.files.named_values import Values
from greybox.modeling.colored_disturbance import ColoredDisturbance
from greybox.modeling.formula_arguments import Names
from greybox.modeling.known_systems import KnownStateSpace, KnownTransferFunction
from greybox.modeling.model import AnyModel, Model, class_of
from greybox.modeling.model_file import models_of
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import as_list, derivative_function
from greybox.modeling.traced_once import once
from greybox.modeling.transfer_function import (
    FeedbackLoop,
    RenamedParameters,
    SeriesConnection,
    TransferFunction,
)

POINTS = 3  # at which formulas are compared: at one of them, a branch may be inactive by chance
SPREADS = (
    1.0,
    30.0,
)  # of signals, where two models are compared: limits have an effect at large ones
NO_VALUES: Values = MappingProxyType({})


def reference(model: Model) -> dict[str, Any]:
    """Return ``{"class": "module:Class", "arguments": [...], "keywords": {...}}`` and names."""
    positional, named = model.arguments
    return {
        "class": f"{type(model).__module__}:{type(model).__qualname__}",
        "arguments": [_plain(value) for value in positional],
        "keywords": {name: _plain(value) for name, value in named.items()},
        "parameters": [*model.parameters],
        "formula": formula_values(model),
    }


@once  # for all parts of a fit
def formula_values(
    model: Model, values: Values = NO_VALUES, spread: float = 1.0
) -> list[float | None]:
    """Return the values of a model's formulas at a few points, by which a changed one is noticed.

    Numbers, unlike the operations, do not change with the version of CasADi or with another way to
    write the same formula. None stands for a value that is not finite; empty if the model cannot be
    evaluated with numbers. Parameters without one of the `values` differ from point to point, and
    so do the signals, between -`spread` and `spread`.
    """
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            rows = [_values_at(model, k, values, spread) for k in range(POINTS)]
            numbers = np.concatenate(rows)
    except Exception:  # a formula may raise anything at values that it was not made for
        return []
    return [number if np.isfinite(number) else None for number in numbers.tolist()]


def _values_at(model: Model, point: int, values: Values, spread: float) -> Any:
    """Return the values of a model's formulas at one of the points, as real numbers."""

    def numbers(names: Sequence[str], center: float) -> dict[str, Any]:
        # By name, since the order of parameters may change: within one of the center.
        shares = [zlib.crc32(f"{name} {point}".encode()) / 2**32 for name in names]
        return {n: np.float64(center + 2 * h - 1) for n, h in zip(names, shares, strict=True)}

    def signals(names: Sequence[str]) -> Names:
        return Names({n: spread * value for n, value in numbers(names, 0.0).items()})

    stated = {name: np.float64(value) for name, value in values.items()}
    p = Names({**numbers([*model.parameters], 1.1), **stated})
    if isinstance(model, TransferFunction):
        s = spread * np.array([0.3 + 0.8j * (point + 1)])
        response = complex(np.asarray(model.response(s, p)).item())
        return np.array([response.real, response.imag])
    if not isinstance(model, StateSpace):
        return np.zeros(0)
    x, u = signals(model.states), signals(model.inputs)
    rates: Any = ()
    if model.states:  # the function that a fit has traced already
        rates = derivative_function(model)([*x.values(), *u.values()], [*p.values()])
    delays = [p[model.delays[name]] for name in model.inputs if name in model.delays]
    outputs = [float(value) for value in as_list(model.output(x, u, p))]
    return np.array([*np.asarray(rates).ravel(), *outputs, *delays])


def same_formulas(model: Model, other: Model, values: Values, fixed: Values = NO_VALUES) -> bool:
    """Return whether a model with parameters at `values` has the formulas of the other at `fixed`.

    All other parameters have the same values in both models.
    """
    is_finite: Any = False
    for spread in SPREADS:
        results = np.array(formula_values(model, values, spread), dtype=float)
        other_results = np.array(formula_values(other, fixed, spread), dtype=float)
        if results.shape != other_results.shape or not other_results.size:
            return False
        # The relative tolerance is a thousand times the rounding of a long formula. Terms that
        # cancel leave 1e-14 of their size.
        size = np.abs(other_results[np.isfinite(other_results)]).max(initial=0.0)
        if not np.allclose(results, other_results, rtol=1e-9, atol=1e-14 * size, equal_nan=True):
            return False
        is_finite = is_finite | np.isfinite(other_results).reshape(POINTS, -1).any(axis=0)

    # Two formulas that are nowhere finite would look alike.
    return bool(np.all(is_finite))


def resolve(stored: Mapping[str, Any], given: Sequence[AnyModel] = ()) -> Model:
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
        is_changed = not different and _is_changed(stored.get("formula"), model)
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
    if is_changed:
        raise ValueError(
            f"the formulas of the model {printable(class_name)} are not those of the fitted one: "
            "give the model as it was fitted, gb.load(path, models=[...]), load the fit without "
            "models for its numbers alone, or fit again."
        )
    return model


def _is_changed(stored: Any, model: Model) -> bool:
    """Return whether the formulas have other values than those of a reference, if it has some."""
    now = formula_values(model)
    if not (stored and now):
        return False
    before, after = np.array(stored, dtype=float), np.array(now, dtype=float)
    if before.shape != after.shape:
        return True
    # Other processors and libraries round differently.
    size = np.abs(after[np.isfinite(after)]).max(initial=0.0)
    return not np.allclose(before, after, rtol=1e-6, atol=1e-9 * size, equal_nan=True)


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
