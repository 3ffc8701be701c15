"""The command `greybox list`: the included models and problems."""

import argparse
import re
from types import ModuleType
from typing import Any

from greybox.cli.catalog import find_model, find_problem, models_of, shipped, shipped_module
from greybox.cli.options import add_common_options
from greybox.cli.output import USABLE, Answer
from greybox.files.json_numbers import finite
from greybox.files.text_table import number, text_table
from greybox.modeling.model import Model, equation

EXAMPLES = (
    "",
    "pitch_hover",
    "tilt:Tilt",
    "my.py:Model",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "name",
        nargs="?",
        metavar="NAME",
        help="show the details of one: a problem, or a model such as tilt:Tilt",
    )
    add_common_options(parser)


def run(options: argparse.Namespace) -> Answer:
    """List the included models and problems, or show the details of one."""
    if options.name is not None:
        return _show(options.name)
    problems = [(name, _doc(shipped_module("problems", name))) for name in shipped("problems")]
    models = [
        (f"{name}:{model.__name__}", equation(model))
        for name in shipped("models")
        for model in models_of(shipped_module("models", name))
    ]
    tables = [
        text_table([title, "what it is"], [[name, _first(doc)] for name, doc in rows], (0, 1))
        for title, rows in (("problem", problems), ("model", models))
    ]
    titles = dict.fromkeys(
        re.split(r", (?=[(]|section|below|which)", _source(doc))[0]
        for _, doc in (*problems, *models)
        if _source(doc)
    )
    sources = "\n".join(f"Source: {title}" for title in titles)
    last = "`greybox list NAME` shows the details of one, with its equation."
    answer = {
        kind: [
            {"name": name, "summary": _first(doc), "source": _source(doc), "about": doc}
            for name, doc in rows
        ]
        for kind, rows in (("problems", problems), ("models", models))
    }
    return answer, "\n\n".join([*tables, sources, last]), USABLE


def _show(name: str) -> Answer:
    if ":" in name or name.endswith(".py"):
        model = find_model(name)
        return (
            {"name": name, "about": equation(model), **_parameters(model)},
            _model_text(model),
            USABLE,
        )
    module = shipped_module("problems", name)
    problem, _ = find_problem(name)
    parts = "\n\n".join(dict.fromkeys(_model_text(part.model) for part in problem.parts))
    models = [{"name": part.model.label, **_parameters(part.model)} for part in problem.parts]
    return (
        {"name": name, "about": _doc(module), "models": models},
        f"{name}\n\n{_doc(module)}\n\n{parts}",
        USABLE,
    )


def _parameters(model: Model) -> dict[str, Any]:
    rows = [
        {
            "name": n,
            "start": p.start,
            "bounds": [finite(end) for end in p.bounds],
            "unit": p.unit,
            "about": p.about,
        }
        | {"fixed": p.fixed, "scale": p.scale}
        for n, p in model.parameters.items()
    ]
    return {
        "parameters": rows,
        "inputs": list(model.input_names),
        "outputs": list(model.output_names),
    }


def _model_text(model: Model) -> str:
    rows = [
        [
            name,
            number(p.start),
            f"[{p.bounds[0]:g}, {p.bounds[1]:g}]",
            p.unit,
            "fixed" if p.fixed else "",
            p.about,
        ]
        for name, p in model.parameters.items()
    ]
    table = text_table(["parameter", "start", "bounds", "unit", "", "meaning"], rows, (0, 3, 4, 5))
    signals = f"{', '.join(model.input_names)} -> {', '.join(model.output_names)}"
    return f"{model.label}: {signals}\n\n{equation(model)}\n\n{table}"


def _doc(module: ModuleType) -> str:
    return (module.__doc__ or "").strip()


def _first(doc: str) -> str:
    return doc.partition("\n\n")[0].replace("\n", " ")


def _source(doc: str) -> str:
    # A capital before the dot is somebody's first name.
    match = re.search(r"Source: (.+?)(?:(?<![A-Z])\.\s|\.$|\n\n|$)", doc, re.DOTALL)
    return " ".join(match[1].split()) if match else ""
