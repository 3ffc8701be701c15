"""Files that may be written."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from greybox.cli.options import UsageError
from greybox.cli.output import has_working_directory, require_figure, require_writable, save_figure


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
    def broken():
        raise ValueError("nothing to draw")

    with pytest.raises(ValueError, match="nothing to draw"):
        save_figure(tmp_path / "a.png", broken)
    assert list(tmp_path.iterdir()) == []
    assert save_figure(tmp_path / "a.png", Figure) == [f"drew {tmp_path / 'a.png'}"]
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert save_figure(None, broken) == []


def test_a_folder_that_cannot_be_written_is_said_before_the_work(tmp_path, monkeypatch):
    """As of another user; this one may be root, who can write everywhere."""
    monkeypatch.setattr("greybox.cli.output.os.access", lambda path, mode: path != tmp_path)
    with pytest.raises(
        UsageError, match=r"the folder of .*fit\.h5 cannot be written: give another one"
    ):
        require_writable(tmp_path / "fit.h5", force=False)


def test_a_working_directory_that_was_removed_is_said(tmp_path, monkeypatch):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    assert has_working_directory()
    gone.rmdir()
    assert not has_working_directory()
    with pytest.raises(
        UsageError, match="the working directory was removed: change to one that exists"
    ):
        require_writable(Path("fit.h5"), force=False)
    require_writable(tmp_path / "fit.h5", force=False)
