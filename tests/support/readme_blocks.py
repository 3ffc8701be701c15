"""The generated tables of docs/included.md and the picture of the README.

Running this file writes them.
"""

import re
from pathlib import Path

import greybox as gb
from greybox.modeling.model import equation
from greybox.workflows.study.catalog import find_problem, models_of, shipped, shipped_module

README = Path(__file__).parents[2] / "README.md"
INCLUDED = README.parent / "docs" / "included.md"
PICTURE = README.parent / "docs" / "pitch_hover.png"
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")
# reach the values of 200 starts to 8e-8; tests/problems holds the minima against those of 1000
# starts
STARTS = 20


def refitted(name):
    """Return the fit of a shipped problem."""
    return gb.fit(find_problem(name)[0], starts=STARTS, seed=0, progress=False)


def problems_table(refitted):
    """One row per problem: published and refitted values side by side."""
    lines = [
        "| problem | what it is | published | refitted | cost, published | cost, refitted |",
        "| --- " * 6 + "|",
    ]
    for name in shipped("problems"):
        module = shipped_module("problems", name)
        fit = refitted(name)
        published = getattr(module, "published", {})
        values = {n: v for n, v in fit.estimate.items() if n in fit.free}
        about = (module.__doc__ or "").partition("\n")[0]
        cost = f"{published['cost']:.4f}" if published else ""
        old = _values(published.get("values", {}), published.get("source", ""))
        lines.append(
            f"| `{name}` | {about} | {old} | {_values(values)} | {cost} | {fit.cost:.4f} |"
        )
    return "\n".join(lines)


def models_table():
    """One row per model."""
    lines = ["| model | what it is |", "| --- | --- |"]
    for name in shipped("models"):
        for model in models_of(shipped_module("models", name)):
            lines.append(f"| `{name}:{model.__name__}` | {equation(model).partition(chr(10))[0]} |")
    return "\n".join(lines)


def least_squares_table():
    """One row per table of the paper: what plain least squares (3.17) gives."""
    lines = ["| data | least squares (3.17), n = 4, m = 1 | cost (4.26) |", "| --- " * 3 + "|"]
    for name in ("roll_hover_ls", "pitch_hover_ls", "yaw_hover_ls"):
        data = shipped_module("problems", name).data()
        found = gb.regression.levy(data, 4, 1, integrator=name.startswith("yaw"))
        lines.append(f"| `{name}` | {found.factored} | {found.cost:.4f} |")
    return "\n".join(lines)


def draw_picture(path):
    """Draw what `greybox fit pitch_hover --plot` draws, smaller, and write the texts of its axes
    into the file."""
    problem, settings = find_problem("pitch_hover")
    figure = gb.plot(gb.fit(problem, **settings, progress=False))
    texts = [
        text
        for ax in figure.axes
        for text in (ax.get_title(), ax.get_xlabel(), ax.get_ylabel())
        if text
    ]
    figure.savefig(path, dpi=100, metadata={"Description": "; ".join(texts)})


def written(text, refitted=refitted):
    """Return the text with its tables made anew.

    The fits of the shipped problems are those of ``refitted(name)``.
    """
    tables = {
        "problems": problems_table(refitted),
        "least squares": least_squares_table(),
        "models": models_table(),
    }
    for title, table in tables.items():
        pattern = rf"(<!-- {title} -->\n).*?(<!-- end -->)"
        text = re.sub(
            pattern, lambda m, table=table: f"{m[1]}{table}\n{m[2]}", text, flags=re.DOTALL
        )
    return text


def _values(values, source=""):
    return (f"{source} " if source else "") + ", ".join(
        f"{name} {value:.4g}" for name, value in values.items()
    )


if __name__ == "__main__":
    draw_picture(PICTURE)
    INCLUDED.write_text(written(INCLUDED.read_text(encoding="utf-8")), encoding="utf-8")
