"""What several test files share."""

import importlib
import inspect
import pkgutil

import casadi as ca
import numpy as np

import greybox as gb
import greybox.models
from greybox.modeling.linear_response import response_formulas
from greybox.modeling.pade_delay import delay_order


def shipped_models():
    """Every model class in greybox.models, by its name."""
    modules = [
        importlib.import_module(f"greybox.models.{m.name}")
        for m in pkgutil.iter_modules(gb.models.__path__)
    ]
    classes = [
        found
        for module in modules
        for _, found in inspect.getmembers(module, inspect.isclass)
        if issubclass(found, gb.modeling.Model) and found.__module__ == module.__name__
    ]
    return {found.__name__: found for found in classes}


def random_values(model, random):
    """Values drawn from the start boxes, evenly in the parameter's own scale."""
    values = {}
    for name, parameter in model.parameters.items():
        box = np.array(parameter.box)
        values[name] = float(
            np.exp(random.uniform(*np.log(box)))
            if parameter.scale == "log"
            else random.uniform(*box)
        )
    return values


def input_output_pairs(model):
    return [(i, o) for i in model.input_names for o in model.output_names]


def response_formula(model, omega, *, input="", output="", **options):
    """One frequency response, compiled as `response_formulas` does."""
    [formula] = response_formulas(model, omega, [(input, output)], **options)
    return formula


def compiled_response(model, omega, delay="exact", **options):
    """The response as the optimizer sees it, through CasADi.

    A function of the parameter values by name.
    """
    function = response_formula(model, omega, pade=delay_order(delay), **options).closed()

    def response(values=None):
        re, im = function(list(model.values(values).values()))
        return np.asarray(re).ravel() + 1j * np.asarray(im).ravel()

    return response


def numeric_jacobian(function, x, step=1e-5):
    """Fourth-order central differences, (n outputs, n parameters)."""
    x = np.asarray(x, dtype=float)
    columns = []
    for k, size in enumerate(np.maximum(np.abs(x), 1e-2)):
        h = np.zeros_like(x)
        h[k] = step * size
        difference = 8 * (function(x + h) - function(x - h)) - (
            function(x + 2 * h) - function(x - 2 * h)
        )
        columns.append(difference / (12 * h[k]))
    return np.stack(columns, axis=-1)


def evaluate(expression):
    """A CasADi expression without symbols as a number or a flat array."""
    value = np.asarray(ca.evalf(expression)).ravel()
    return value[0] if value.size == 1 else value
