"""Property tests try the same examples everywhere; ``HYPOTHESIS_PROFILE=default python -m pytest`` explores others."""

import os

# Tests run in as many processes as there are cores: threads within each would only wait for one
# another. On two cores the suite takes 3 min 16 s with one thread a process, 4 min 35 s with two.
# Set before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Without bytecode on disk, every process that a test starts compiles greybox anew: 0.9 s each.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import atexit
import gc
import shutil
import signal
import sys
import tempfile
from contextlib import contextmanager
from importlib import import_module

import pytest
from core_tests import core_tests
from hypothesis import settings

sys.dont_write_bytecode = False

# The key of the user of these tests: they leave nothing in the home of whoever runs them.
if "GREYBOX_TESTS" not in os.environ:
    os.environ["GREYBOX_TESTS"] = os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp("greybox")
    atexit.register(shutil.rmtree, os.environ["GREYBOX_TESTS"], ignore_errors=True)

# Collection makes millions of objects and no garbage: a third of its time is the collector's.
gc.disable()

# The slowest files and slow ones of the last folder begin first, so that no core waits for them at
# the end.
FIRST = (
    "test_structures_over_flights.py",
    "test_readme.py",
    "test_record_problems.py",
    "test_nested_models.py",
    "test_nesting.py",
    "test_held_out.py",
    "test_stepwise.py",
)

settings.register_profile("steady", derandomize=True, deadline=None, database=None, max_examples=40)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "steady"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    # Before pytest leaves out what `-m` does not name.
    for item in core_tests(items):
        item.add_marker("core")
    items.sort(key=lambda item: item.path.name not in FIRST)


def pytest_collection_finish():
    # The collector begins after every 700 new objects otherwise, and looks at all tests and modules
    # each time: a fiftieth of the time.
    gc.set_threshold(20_000)
    gc.enable()


# Where damaged and crafted files are read, and how that is done.
IN_SUBPROCESS = (
    "test_readers.py",
    "test_files_from_strangers.py",
)


@pytest.fixture(scope="module", autouse=True)
def most_files_are_read_here(request):
    """Read what the tests themselves saved in this process: it saves a fifth of a second a file.

    Set once for a file of tests: anew for each test, it would take half a millisecond of them all.
    """
    from read_here import read_here  # not above: it imports numpy

    with pytest.MonkeyPatch.context() as patch:
        if request.path.name not in IN_SUBPROCESS:
            patch.setattr("greybox.data.logs.readers.named_arrays.read_in_subprocess", read_here)
        yield


@pytest.fixture
def few_draws(monkeypatch):
    """Take 64 draws for the intervals of margins instead of 512: an eighth of the time.

    And fewer gains. For tests in which the ends of intervals do not matter to a few per cent.
    """
    plants = {"DRAWS": 64, "DRAWN": slice(1, 65), "BESIDE": slice(65, None)}
    # By their paths: `greybox.workflows.experiment.margins` is the function.
    modules = ("drawn_loops", "margins", "measured_loop_margins", "safe_gains")
    for path in (*(f"workflows.experiment.{name}" for name in modules), "reporting.plotting.loops"):
        module = import_module(f"greybox.{path}")
        for name in plants.keys() & vars(module).keys():
            monkeypatch.setattr(module, name, plants[name])
    safe_gains = import_module("greybox.workflows.experiment.safe_gains")
    monkeypatch.setattr(safe_gains, "POINTS", {1: 11, 2: 5, 3: 3})


@contextmanager
def without_misfit():
    """Leave out the assessment of the misfit, a third of the time of a fit of records.

    For tests of estimates and errors alone: those in tests/assessment assess fits of all kinds.
    """
    module = import_module("greybox.assessment.assess")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "assessed_misfit", lambda *_: None)
        yield


@pytest.fixture
def unjudged():
    """Make fits without a misfit in a test."""
    with without_misfit():
        yield


@pytest.fixture(scope="module")
def unjudged_file():
    """Make fits without a misfit in a file of tests and its fixtures."""
    with without_misfit():
        yield


@pytest.fixture
def judged(monkeypatch):
    """Make fits with their misfit in a test of a file without."""
    from greybox.assessment.misfit.assessment import assessed_misfit

    module = import_module("greybox.assessment.assess")
    monkeypatch.setattr(module, "assessed_misfit", assessed_misfit)


@pytest.fixture
def undrawn(monkeypatch):
    """Write figures without their pixels, which cost most of a second each."""
    from matplotlib.figure import Figure

    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: path.write_bytes(b"no pixels"))


@pytest.fixture
def clock(monkeypatch):
    """A clock of time limits that goes on by a second at every look."""

    class Clock:
        now = 0.0

        @classmethod
        def time(cls):
            cls.now += 1.0
            return cls.now

    monkeypatch.setattr("greybox.engine.solve.interruption.time", Clock)
    return Clock


@pytest.fixture
def press_ctrl_c():
    """Send this process the signal that Ctrl-C sends, with Python's handler for it, which parallel tests ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield lambda: os.kill(os.getpid(), signal.SIGINT)
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def small_study(tmp_path_factory):
    """Three structures on three data sets, one fit twice, and a member that fails; made once."""
    from small_study import members

    import greybox as gb

    return gb.batch(members(), tmp_path_factory.mktemp("study") / "small", progress=False)
