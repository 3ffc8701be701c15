"""The command `greybox list`: the included models and problems."""

import argparse
from collections.abc import Mapping, Sequence
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
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = """
name [NAME]
    show the details of one: a problem, or a model such as tilt:Tilt
"""


def run(options: argparse.Namespace) -> Answer:
    """List the included models and problems, or show one."""
    if options.name:
        return _show(options.name)

    problem_docs = {name: _doc(shipped_module("problems", name)) for name in shipped("problems")}
    model_docs = {}
    for name in shipped("models"):
        for model in models_of(shipped_module("models", name)):
            model_docs[f"{name}:{model.__name__}"] = equation(model)

    problems = _described(problem_docs)
    models = _described(model_docs)
    blocks = [
        _summary_table("problem", problems),
        _summary_table("model", models),
        "`greybox list NAME` shows the details of one, with equation and source.",
    ]
    return {"problems": problems, "models": models}, "\n\n".join(blocks)


def _described(docs: Mapping[str, str]) -> list[dict[str, str]]:
    """Return name, summary and docstring of every item, from docstrings by name."""
    items = []
    for name, doc in docs.items():
        # The first paragraph of a docstring is its summary.
        summary = " ".join(doc.split("\n\n")[0].split())
        items.append({"name": name, "summary": summary, "about": doc})
    return items


def _summary_table(kind: str, items: Sequence[Mapping[str, str]]) -> str:
    """Return the table of the names and summaries of items."""
    rows = [(item["name"], item["summary"]) for item in items]
    return text_table([kind, "what it is"], rows, left=(0, 1))


def _show(name: str) -> Answer:
    """Show the details of a model or a problem."""
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
    """Return parameters, inputs and outputs of a model, for JSON."""
    parameters = []
    for name, parameter in model.parameters.items():
        fields = attributes(parameter, "start", "bounds", "unit", "about", "fixed", "scale")
        parameters.append({"name": name, **fields})
    return {"parameters": parameters, "inputs": model.input_names, "outputs": model.output_names}


def _model_text(model: Model) -> str:
    """Return signals, equation and parameters of a model as text."""
    signals = f"{', '.join(model.input_names)} -> {', '.join(model.output_names)}"
    return f"{model.label}: {signals}\n\n{equation(model)}\n\n{parameter_table(model.parameters)}"


def _doc(module: ModuleType) -> str:
    return (module.__doc__ or "").strip()
