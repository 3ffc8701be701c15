"""Studies of strangers: reading follows nothing and writes nothing, and resumes only what is one's own."""

import os
import runpy
import sqlite3
import struct
import subprocess
import sys
import time
import tracemalloc
import zlib
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
from crafted_studies import (
    contents,
    kill_in_transaction,
    plant_journal,
    put_answer,
    study_of,
)
from declared_models import TWO_LAGS_OMEGA, Lag, measured

import greybox as gb
from greybox.cli.main import main
from greybox.engine.solve.runs import IMPROVED, Outcome
from greybox.workflows.study import ownership
from greybox.workflows.study.database import DATABASE
from greybox.workflows.study.members import read_members
from greybox.workflows.study.ownership import key_path
from greybox.workflows.study.stored_runs import StoredRuns, folder_beside
from greybox.workflows.study.study_lock import LOCK, locked

FAILED = {"error": "no start"}
VICTIMS = (
    "absolute.txt",
    "../relative.txt",
    "/proc/self/cwd/linked.txt",
    "./here.txt",
    "with blanks.txt",
    "Umläute 日本.txt",
    "link.txt",
    "long" + "g" * 200 + ".txt",
)


def stored(folder, number=5):
    """A member with runs."""
    runs = StoredRuns(folder, "fit")
    runs.stored("a problem")
    for k in range(number):
        runs.add(
            k, np.array([k, 1.0]), Outcome(np.array([1.0, k]), "done", 3, 0.1, True, stage=IMPROVED)
        )
    runs.write()
    return runs


@pytest.fixture
def victim(tmp_path, monkeypatch, request):
    """A file of the reader, and its name in a crafted journal; the study is in ``mail/study``."""
    name = request.param
    folder = tmp_path / "mail" / "study"
    folder.mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "mail")
    path = (tmp_path / "mail" / Path(name.replace("/proc/self/cwd/", ""))).resolve()
    path.write_text("precious")
    if name.startswith("link"):
        target = path.with_name("target.txt")
        path.replace(target)
        path.symlink_to(target)
    if name.startswith("/") and not Path("/proc/self/cwd").exists():
        pytest.skip("the system has no such name")
    if not name.startswith((".", "/")):
        name = str(path)
    study_of(folder, broken=FAILED)
    stored(folder)
    plant_journal(folder, name)
    return path, folder


def entries(folder):
    """Everything that reads a study, or resumes one."""
    problem = gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA, {"K": 2.0}, noise=0.02))
    yield lambda: gb.study.read_study(folder)
    yield lambda: gb.study.read_study(os.path.relpath(folder))
    yield lambda: main(["compare", str(folder)])
    yield lambda: main(["report", str(folder), "--out", "page.html", "--force"])
    yield lambda: main(["batch", "--status", str(folder)])
    yield lambda: main(["batch", "--check", str(folder)])
    yield lambda: main(["batch", "--resume", str(folder)])
    yield lambda: gb.batch([gb.study.Member(problem, 1)], folder, progress=False)
    yield lambda: gb.batch([gb.study.Member(problem, 1)], folder, progress=False, trust=True)


@pytest.mark.parametrize("victim", VICTIMS, indirect=True)
def test_no_entry_deletes_what_a_journal_names(victim, capsys):
    path, folder = victim
    whole = contents(folder)
    for read in entries(folder):
        with suppress(ValueError):
            read()
        assert path.read_text() == "precious"
        assert contents(folder) | whole == contents(folder)
        assert {p.name for p in contents(folder)} <= {p.name for p in whole} | {LOCK}
    study = gb.study.read_study(folder)
    assert [m.name for m in study.members] == ["broken", "fit"]
    assert study["fit"].runs == 5


def test_a_fit_beside_planted_runs_deletes_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = folder_beside(Path("f.h5"))
    folder.mkdir()
    stored(folder)
    Path("precious.txt").write_text("precious")
    plant_journal(folder, "precious.txt")
    whole = contents(folder)
    assert main(["fit", "rotors", "--starts", "1", "--out", "f.h5", "--json"]) == 2
    assert "journal names another file" in capsys.readouterr().out
    assert Path("precious.txt").read_text() == "precious"
    assert contents(folder) | whole == contents(folder)


def test_reading_writes_nothing_also_where_it_may_not(tmp_path):
    study_of(tmp_path, broken=FAILED)
    whole = contents(tmp_path)
    stamps = {path: path.stat().st_mtime_ns for path in (tmp_path, tmp_path / DATABASE)}
    assert gb.study.read_study(tmp_path).count("failed") == 1
    assert contents(tmp_path) == whole
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps


def test_a_study_killed_in_a_commit_is_read_and_resumed_as_it_was_before(tmp_path):
    folder = tmp_path / "study"
    folder.mkdir()
    study_of(folder, **{f"member {k}": FAILED for k in range(50)})
    stored(folder, 200)
    kill_in_transaction(folder, "UPDATE runs SET run = 'half ' || run, checksum = 0")
    killed = contents(folder)
    for _ in range(2):
        members = read_members(folder)
        assert [m.runs for m in members if m.name == "fit"] == [200]
        assert sum(m.status == "failed" for m in members) == 50
        assert contents(folder) == killed
    # The next writer rolls it back, and loses nothing.
    with locked(folder):
        assert len(StoredRuns(folder, "fit").stored("a problem")) == 200
    assert not (folder / f"{DATABASE}-journal").exists()


WRITER = """
import sys
from pathlib import Path
import numpy as np
from greybox.engine.solve.runs import IMPROVED, Outcome
from greybox.workflows.study.stored_runs import StoredRuns
runs = StoredRuns(Path(sys.argv[1]), "fit")
runs.fingerprint = "a problem"
for k in range(5, 45):
    runs.add(k, np.array([k, 1.0]), Outcome(np.array([1.0, k]), "done", 3, 0.1, True, stage=IMPROVED))
    runs.write()
"""


def test_a_study_is_read_while_it_is_written(tmp_path):
    stored(tmp_path)
    counts = [5]
    with subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)]) as writer:
        while writer.poll() is None:
            counts.append(read_members(tmp_path)[0].runs)
            time.sleep(0.02)
    assert writer.returncode == 0
    assert counts == sorted(counts)
    assert read_members(tmp_path)[0].runs == 45
    assert len(StoredRuns(tmp_path, "fit").stored("a problem")) == 45


@pytest.mark.parametrize("ending", ["", "-journal", "-wal", "-shm"])
@pytest.mark.parametrize("kind", ["link", "pipe", "file"])
def test_what_lies_beside_a_database_is_not_followed(tmp_path, ending, kind):
    folder, outside = tmp_path / "study", tmp_path / "outside"
    folder.mkdir()
    study_of(folder, broken=FAILED)
    whole = (folder / DATABASE).read_bytes()
    place = folder / f"{DATABASE}{ending}"
    if kind == "link":
        outside.write_bytes(whole)
        place.unlink(missing_ok=True)
        place.symlink_to(outside)
    elif kind == "pipe":
        place.unlink(missing_ok=True)
        os.mkfifo(place)
    elif ending in ("", "-journal"):
        return  # ordinary files
    else:
        place.write_bytes(b"\x37\x7f\x06\x82" + bytes(200))
    for read in (gb.study.read_study, lambda path: locked(path).__enter__()):
        with pytest.raises(
            (ValueError, FileNotFoundError), match=r"link|not a file of|not a study"
        ):
            read(folder)
    if kind == "link":
        assert outside.read_bytes() == whole
    assert {p.name for p in folder.iterdir()} <= {DATABASE, place.name, LOCK}


def test_a_lock_that_is_a_link_empties_no_file(tmp_path):
    folder, outside = tmp_path / "study", tmp_path / "outside"
    folder.mkdir()
    outside.write_text("precious")
    (folder / LOCK).symlink_to(outside)
    with pytest.raises(ValueError, match="is a link"), locked(folder):
        pass
    assert outside.read_text() == "precious"


def test_a_database_with_a_write_ahead_log_is_none_of_ours(tmp_path):
    study_of(tmp_path, broken=FAILED)
    with closing(sqlite3.connect(tmp_path / DATABASE)) as database:
        database.execute("PRAGMA journal_mode = WAL")
    whole = contents(tmp_path)
    with pytest.raises(ValueError, match="is damaged or not a study"):
        read_members(tmp_path)
    assert contents(tmp_path) == whole


def test_pages_that_many_rows_share_are_refused(tmp_path):
    # All children of a page of the tree are the same one: its rows would be read again and again.
    stored(tmp_path, 300)
    path = tmp_path / DATABASE
    with closing(sqlite3.connect(path)) as database:
        (root,) = database.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = 'runs'"
        ).fetchone()
    data = bytearray(path.read_bytes())
    page = 1024 * (root - 1)
    assert data[page] == 5  # an interior page
    (count,) = struct.unpack_from(">H", data, page + 3)
    cells = struct.unpack_from(f">{count}H", data, page + 12)
    for cell in cells:
        data[page + cell : page + cell + 4] = data[page + cells[0] : page + cells[0] + 4]
    path.write_bytes(data)
    with pytest.raises(ValueError, match="is damaged"):
        read_members(tmp_path)


@pytest.fixture
def another_user(monkeypatch, tmp_path_factory):
    """Return a function that makes this process that of another user."""

    def change():
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))

    return change


def test_runs_of_another_user_are_resumed_only_with_trust(tmp_path, another_user):
    stored(tmp_path)
    study_of(tmp_path, broken=FAILED)
    another_user()
    whole = contents(tmp_path)
    assert read_members(tmp_path)[0].runs == 5
    with (
        pytest.raises(ValueError, match=r"5 runs and 1 answer that were not made here by you"),
        locked(tmp_path),
    ):
        pass
    assert contents(tmp_path) | whole == contents(tmp_path)
    with locked(tmp_path, trust=True):
        assert len(StoredRuns(tmp_path, "fit").stored("a problem")) == 5
    with locked(tmp_path):  # they are now one's own
        assert [m.runs for m in read_members(tmp_path)] == [5, 0]


def test_a_key_is_readable_by_its_user_alone_and_stays(another_user):
    another_user()
    assert key_path().parent.parent.exists()
    first = ownership.mark("a")
    assert key_path().stat().st_mode & 0o777 == 0o600
    again = runpy.run_path(ownership.__file__)  # as another process does
    assert again["mark"]("a") == first


@pytest.mark.parametrize("column", ["run", "mark", "number"])
def test_a_run_that_a_stranger_changed_is_not_resumed(tmp_path, column):
    stored(tmp_path)
    with closing(sqlite3.connect(tmp_path / DATABASE)) as database, database:
        database.create_function("crc", -1, gb.study.database._checksum)
        change = {
            "run": "run = replace(run, '3', '4')",
            "mark": "mark = zeroblob(16)",
            "number": "number = number + 100",
        }
        database.execute(f"UPDATE runs SET {change[column]}")
        database.execute("UPDATE runs SET checksum = crc(run, 'fit', number, 'a problem', mark)")
    assert read_members(tmp_path)[0].runs == 5
    with pytest.raises(ValueError, match="5 runs that were not made here by you"), locked(tmp_path):
        pass


def test_a_batch_and_a_bootstrap_of_another_user_need_trust(tmp_path, another_user):
    problem = gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA, {"K": 2.0}, noise=0.02))
    member = gb.study.Member(problem, 2)
    study = gb.batch([member], tmp_path / "batch", progress=False)
    fit = study.members[0].answer["cost"]
    whole = gb.fit(problem, starts=2)
    gb.bootstrap(whole, 4, folder=tmp_path / "bootstrap", progress=False)
    another_user()
    with pytest.raises(ValueError, match="not made here by you"):
        gb.batch([member], tmp_path / "batch", progress=False)
    with pytest.raises(ValueError, match="not made here by you"):
        gb.bootstrap(whole, 4, folder=tmp_path / "bootstrap", progress=False)
    again = gb.batch([member], tmp_path / "batch", progress=False, trust=True)
    assert again.members[0].answer["cost"] == fit
    gb.bootstrap(whole, 4, folder=tmp_path / "bootstrap", progress=False, trust=True)


def worst(kind):
    """Return an answer of a megabyte or so that takes as much memory as the reader allows."""
    noise = np.random.default_rng(0).bytes(60_000).hex()  # hardly compressed
    if kind == "nested lists":
        text = '{"error": [' + "[" * 900 + "]" * 900 + ("," + "[" * 900 + "]" * 900) * 2000 + "]}"
    elif kind == "nested objects":
        one = '{"":' * 200 + "0" + "}" * 200
        text = f'{{"noise": "{noise}", "error": [{", ".join([one] * 300)}]}}'
    else:
        texts = [f'"{k} {"a" * 9000}\U0001f600"' for k in range(430)]
        text = f'{{"noise": "{noise}", "warnings": [{", ".join(texts)}]}}'
    return zlib.compress(text.encode(), 9)


@pytest.mark.parametrize("kind", ["nested lists", "nested objects", "wide texts"])
def test_memory_is_a_multiple_of_the_file(tmp_path, kind):
    study_of(tmp_path, broken=FAILED)
    put_answer(tmp_path, worst(kind))
    size = (tmp_path / DATABASE).stat().st_size
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"answer of 'broken' in .* is damaged"):
            gb.study.read_study(tmp_path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 600 * size + 50e6
