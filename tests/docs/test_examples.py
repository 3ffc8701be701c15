"""Examples with answers, as `doctest` reads them: those of public docstrings and of the guide.

An answer that changes fails here. The blocks of the guide without answers run in `test_readme.py`.
"""

import doctest
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import greybox as gb

FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
DOCS = Path(__file__).parents[2] / "docs"
PAGES = [page for page in DOCS.rglob("*.md") if ">>> " in page.read_text(encoding="utf-8")]


def _hold(text, name):
    """Run the examples of a text, and fail with those that give another answer."""
    names = {"gb": gb, "np": np, "__name__": "example"}
    examples = doctest.DocTestParser().get_doctest(text, names, name, None, 0)
    report = []
    doctest.DocTestRunner(optionflags=FLAGS, verbose=False).run(examples, out=report.append)
    if report:
        pytest.fail("".join(report), pytrace=False)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```pycon\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    _hold("\n".join(blocks), page.name)


NAMES = [name for name in dir(gb) if ">>> " in (inspect.getdoc(getattr(gb, name)) or "")]


@pytest.mark.parametrize("name", NAMES)
def test_a_docstring(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _hold(inspect.getdoc(getattr(gb, name)), name)


def test_every_name_at_the_top_has_an_example():
    """Except for namespaces, a number and tuples, which have no docstring of their own."""
    named = {name for name in dir(gb) if callable(getattr(gb, name))}
    assert named - {*NAMES} == set()
