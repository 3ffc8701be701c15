"""The command `greybox list`: the included models and problems."""

import argparse
from types import ModuleType
from typing import Any

from greybox.cli.output import Answer
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import attributes
from greybox.data.files.text_table import text_table
from greybox.modeling.model import Model, equation
from greybox.modeling.parameter import parameter_table
from greybox.workflows.study.catalog import (
    find_model,
    find_problem,
    models_of,
    shipped,
    shipped_module,
)

EXAMPLES = (
    "",
    "pitch_hover",
    "tilt:Tilt",
    "my.py:Model",
)
OPTIONS = """
name [NAME]
    show the details of one: a problem, or a model such as tilt:Tilt
"""


def run(options: argparse.Namespace) -> Answer:
    """List the included models and problems, or show one."""
    if options.name:
        return _show(options.name)

    docs = {
        "problem": {name: _doc(shipped_module("problems", name)) for name in shipped("problems")},
        "model": {
            f"{name}:{model.__name__}": equation(model)
            for name in shipped("models")
            for model in models_of(shipped_module("models", name))
        },
    }
    blocks, answer = [], {}
    for kind, items in docs.items():
        # The first paragraph of a docstring is its summary.
        rows = [(name, " ".join(doc.split("\n\n")[0].split())) for name, doc in items.items()]
        blocks.append(text_table([kind, "what it is"], rows, (0, 1)))
        answer[f"{kind}s"] = [
            {"name": name, "summary": summary, "about": items[name]} for name, summary in rows
        ]

    blocks.append("`greybox list NAME` shows the details of one, with equation and source.")
    return answer, "\n\n".join(blocks)


def _show(name: str) -> Answer:
    if ":" in name or name.endswith(".py") or name in shipped("models"):
        model = find_model(name)
        answer = {"name": name, "about": equation(model), **_parameters(model)}
        return answer, _model_text(model)

    doc = _doc(shipped_module("problems", name))
    problem, _ = find_problem(name)
    # Parts of a joint problem may share a model: its table is printed once.
    models = [part.model for part in problem.parts]
    answer = {
        "name": name,
        "about": doc,
        "models": [{"name": model.label, **_parameters(model)} for model in models],
    }
    return answer, "\n\n".join([name, doc, *unique(map(_model_text, models))])


def _parameters(model: Model) -> dict[str, Any]:
    names = ("start", "bounds", "unit", "about", "fixed", "scale")
    rows = [{"name": name, **attributes(p, *names)} for name, p in model.parameters.items()]
    return {"parameters": rows, "inputs": model.input_names, "outputs": model.output_names}


def _model_text(model: Model) -> str:
    signals = f"{', '.join(model.input_names)} -> {', '.join(model.output_names)}"
    return f"{model.label}: {signals}\n\n{equation(model)}\n\n{parameter_table(model.parameters)}"


def _doc(module: ModuleType) -> str:
    return (module.__doc__ or "").strip()
