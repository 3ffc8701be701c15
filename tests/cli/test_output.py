"""Files that may be written, and values as JSON."""

import json
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.cli.options import UsageError
from greybox.cli.output import require_figure, require_writable, save_figure
from greybox.data.excited_segment import Segment
from greybox.data.files.json_numbers import plain


def test_files_that_exist_are_kept_unless_forced(tmp_path):
    path = tmp_path / "fit.h5"
    require_writable(None, force=False)
    require_writable(path, force=False)
    path.write_text("kept")
    with pytest.raises(UsageError, match=r"fit\.h5 exists: give another name, or --force"):
        require_writable(path, force=False)
    require_writable(path, force=True)
    with pytest.raises(UsageError, match="is a folder: give the name of a file"):
        require_writable(tmp_path, force=True)
    with pytest.raises(UsageError, match="does not exist: create it first"):
        require_writable(tmp_path / "none" / "fit.h5", force=True)


def test_a_figure_has_the_suffix_of_one(tmp_path):
    require_figure(tmp_path / "a.PNG", force=False)
    with pytest.raises(
        UsageError, match=r"not a known kind of figure: end it in \.png, \.pdf, \.svg"
    ):
        require_figure(tmp_path / "a.jpeg", force=False)


def test_a_figure_that_cannot_be_drawn_leaves_no_file(tmp_path):
    data = gb.FrequencyResponse([1.0, 2.0], [1.0, 0.5j])
    with pytest.raises(TypeError, match="cannot draw 'no fit'"):
        save_figure(tmp_path / "a.png", "bode", "no fit")
    assert list(tmp_path.iterdir()) == []
    assert save_figure(tmp_path / "a.png", "bode", data) == [f"drew {tmp_path / 'a.png'}"]
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert save_figure(None, "bode", "no fit") == []


def test_a_folder_that_cannot_be_written_is_said_before_the_work(tmp_path, monkeypatch):
    """As of another user; this one may be root, who can write everywhere."""
    monkeypatch.setattr("greybox.cli.output.os.access", lambda path, mode: path != tmp_path)
    with pytest.raises(
        UsageError, match=r"the folder of .*fit\.h5 cannot be written: give another one"
    ):
        require_writable(tmp_path / "fit.h5", force=False)


def test_values_become_those_of_json():
    segment = Segment(1.0, 2.0, kind="sweep", findings=("short",))
    values = {"segment": segment, "x": np.array([[1.0, np.nan]]), "file": Path("a.csv"), 3: (True,)}
    converted = plain(values)
    assert converted["segment"]["omega"] is None
    assert converted["segment"]["findings"] == ["short"]
    assert (converted["x"], converted["file"], converted["3"]) == ([[1.0, None]], "a.csv", [True])
    json.dumps(converted, allow_nan=False)
