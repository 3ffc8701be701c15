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
    """List the included models and problems, or show one."""
    if options.name is not None:
        return _show(options.name)
    problems = [(name, _doc(shipped_module("problems", name))) for name in shipped("problems")]
    models = [
        (f"{name}:{model.__name__}", equation(model))
        for name in shipped("models")
        for model in models_of(shipped_module("models", name))
    ]
    blocks = []
    answer = {}
    for kind, rows in (("problem", problems), ("model", models)):
        summaries = [(name, doc.partition("\n\n")[0].replace("\n", " ")) for name, doc in rows]
        blocks.append(text_table([kind, "what it is"], summaries, (0, 1)))
        answer[f"{kind}s"] = [
            {"name": name, "summary": summary, "source": source_of(doc), "about": doc}
            for (name, summary), (_, doc) in zip(summaries, rows, strict=True)
        ]

    # Of each source only the title: without equation, section or page.
    sources = (source_of(doc) for _, doc in (*problems, *models))
    titles = (re.split(r", (?=[(]|section|below|which)", source)[0] for source in sources)
    blocks.append("\n".join(f"Source: {title}" for title in dict.fromkeys(filter(None, titles))))
    blocks.append("`greybox list NAME` shows the details of one, with its equation.")
    return answer, "\n\n".join(blocks), USABLE


def _show(name: str) -> Answer:
    if ":" in name or name.endswith(".py"):
        model = find_model(name)
        answer = {"name": name, "about": equation(model), **_parameters(model)}
        return answer, _model_text(model), USABLE

    doc = _doc(shipped_module("problems", name))
    problem, _ = find_problem(name)
    models = [part.model for part in problem.parts]
    answer = {
        "name": name,
        "about": doc,
        "models": [{"name": model.label, **_parameters(model)} for model in models],
    }
    return answer, "\n\n".join([name, doc, *dict.fromkeys(map(_model_text, models))]), USABLE


def _parameters(model: Model) -> dict[str, Any]:
    rows = [
        {
            "name": name,
            "start": p.start,
            "bounds": [finite(end) for end in p.bounds],
            "unit": p.unit,
            "about": p.about,
            "fixed": p.fixed,
            "scale": p.scale,
        }
        for name, p in model.parameters.items()
    ]
    names = {"inputs": list(model.input_names), "outputs": list(model.output_names)}
    return {"parameters": rows, **names}


def _model_text(model: Model) -> str:
    rows = []
    for name, p in model.parameters.items():
        bounds = f"[{p.bounds[0]:g}, {p.bounds[1]:g}]"
        rows.append([name, number(p.start), bounds, p.unit, "fixed" if p.fixed else "", p.about])
    table = text_table(["parameter", "start", "bounds", "unit", "", "meaning"], rows, (0, 3, 4, 5))
    signals = f"{', '.join(model.input_names)} -> {', '.join(model.output_names)}"
    return f"{model.label}: {signals}\n\n{equation(model)}\n\n{table}"


def _doc(module: ModuleType) -> str:
    return (module.__doc__ or "").strip()


def source_of(doc: str) -> str:
    """Return the sentence after "Source:"."""
    # A capital before the dot is somebody's first name.
    match = re.search(r"Source: (.+?)(?:(?<![A-Z])\.\s|\.$|\n\n|$)", doc, re.DOTALL)
    return " ".join(match[1].split()) if match else ""
