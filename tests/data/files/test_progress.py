"""Progress bars: in terminals and notebooks, and not in files."""

import io
import sys

import pytest

from greybox.data.files import progress


@pytest.mark.parametrize(
    ("modules", "is_shown", "has_bar"),
    [(["ipykernel"], True, True), (["ipykernel"], False, False), ([], True, False)],
)
def test_a_notebook_has_a_bar_and_a_file_has_none(monkeypatch, modules, is_shown, has_bar):
    monkeypatch.setattr(progress, "DELAY", 0)
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    for name in modules:
        monkeypatch.setitem(sys.modules, name, sys)
    file = io.StringIO()  # like the output of a notebook, it is no terminal
    counts = [*progress.bar(range(3), is_shown=is_shown, file=file, desc="fits")]
    assert counts == [0, 1, 2]
    assert ("fits" in file.getvalue()) == has_bar
