"""The command line as a process of its own.

Ctrl-C, and standard output that is not UTF-8, closed, or full.
"""

import json
import os
import resource
import signal
import subprocess
import sys

import pytest
from command_line import OWN

import greybox as gb

# The command line presses Ctrl-C itself, at the third start.
PRESSED = """
import os, signal
from greybox.engine.solve.response_solver import ResponseSolver as Solver

run, begun = Solver.run, []

def pressed(self, *arguments):
    begun.append(arguments)
    if len(begun) == 3:
        os.kill(os.getpid(), signal.SIGINT)
    return run(self, *arguments)

Solver.run = pressed
"""


def heed_ctrl_c():
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # which parallel tests ignore, and processes inherit that


def greybox(*arguments, **options):
    command = [sys.executable, "-m", "greybox", *map(str, arguments)]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    return subprocess.run(command, check=False, preexec_fn=heed_ctrl_c, **options)


def test_ctrl_c_prints_and_saves_the_best_fit_so_far(tmp_path):
    (tmp_path / "own.py").write_text(OWN + PRESSED)
    (tmp_path / "fits").mkdir()
    saved = tmp_path / "fits" / "fit.h5"
    done = greybox(
        "fit",
        "own.py",
        "--starts",
        20,
        "--search",
        "multistart",
        "--out",
        saved,
        "--json",
        cwd=tmp_path,
    )
    assert done.returncode == 130
    assert done.stderr == b"greybox: interrupted.\n"
    assert {path.name for path in saved.parent.iterdir()} == {
        "fit.h5",
        "fit.h5.runs",
    }  # the runs, to go on with

    fit = gb.load(saved)
    assert [run.converged for run in fit.runs] == [True, True, False]
    assert "interrupted after 3 of 20 starts" in str(fit)
    answer = json.loads(done.stdout)
    assert answer["estimate"] == pytest.approx(fit.estimate)
    assert answer["error"] == "interrupted."


def with_pressing_module(folder, name):
    """An environment in which the import of a module presses Ctrl-C."""
    (folder / f"{name}.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(0.1)\n"
    )
    return {**os.environ, "PYTHONPATH": str(folder)}


def test_ctrl_c_during_the_first_imports_has_no_traceback(tmp_path):
    done = greybox("list", "--json", env=with_pressing_module(tmp_path, "casadi"))
    assert done.returncode == 130
    assert done.stderr == b"greybox: interrupted.\n"
    assert json.loads(done.stdout) == {"error": "interrupted."}


def test_ctrl_c_while_a_figure_is_drawn_leaves_the_fit(tmp_path):
    environment = with_pressing_module(tmp_path, "matplotlib")
    done = greybox(
        "fit",
        "pitch_hover",
        "--starts",
        2,
        "--plot",
        "x.png",
        "--out",
        "x.h5",
        env=environment,
        cwd=tmp_path,
    )
    assert done.returncode == 130
    assert done.stderr == b"greybox: interrupted.\n"
    assert done.stdout.endswith(b"saved x.h5\nx.png is not drawn\n")
    assert {path.name for path in tmp_path.iterdir()} - {"__pycache__"} == {"matplotlib.py", "x.h5"}


def test_an_answer_in_ascii():
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = greybox("list", "tilt:Tilt", env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert r"1/s\xb2" in done.stdout.decode("ascii")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_a_full_disk_under_standard_output_is_an_error():
    with open("/dev/full", "wb") as full:
        done = greybox("--help", stdout=full)
    assert done.returncode == 1
    assert done.stderr == b"greybox: cannot write to standard output: No space left on device.\n"


def test_too_little_memory_is_said_at_once():
    # 400 MB, with which OpenBLAS would ask again for ever.
    limit = (400 << 20, 400 << 20)
    command = [sys.executable, "-m", "greybox", "fit", "rotors"]
    done = subprocess.run(
        command,
        check=False,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, limit),
    )
    assert done.returncode == 2
    assert "address space" in done.stderr
    assert done.stderr.count("\n") == 1
