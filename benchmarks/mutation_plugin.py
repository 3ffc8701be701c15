"""A plugin of pytest for `mutation.py`.

Note which test executes which line, or run chosen tests in a chosen order.
"""

import gc
import json
import os
from functools import _lru_cache_wrapper
from pathlib import Path

import coverage
import pytest

NOTES = os.environ.get("GREYBOX_MUTATION_NOTES")  # the folder for what a measuring run writes down
ORDER = os.environ.get("GREYBOX_MUTATION_ORDER")  # the file with the tests to run, in their order
OWN = ("greybox", "test_", "tests.", "nist")  # modules whose caches would hide what a test executes

if NOTES:
    _caches: list = []

    def _fixtures(item):
        """Return the names of the fixtures that this test shares with others."""
        found = getattr(item, "_fixtureinfo", None)
        defined = [d for ds in (found.name2fixturedefs.values() if found else ()) for d in ds]
        return [f"fixture {d.baseid}::{d.argname}" for d in defined if d.scope != "function"]

    def _note(**what):
        with open(f"{NOTES}/{os.getpid()}.jsonl", "a") as file:
            file.write(json.dumps(what) + "\n")

    def _processor_time():
        """Return the seconds of processor time of this process and of its children that ended.

        Other work on the machine does not lengthen it, so that the tests of a fault are the same
        there.
        """
        return sum(os.times()[:4])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(item, nextitem):
        """Attribute what is executed to this test, which finds every cache empty."""
        if not _caches or _caches[0] != item.path:
            found = [o for o in gc.get_objects() if isinstance(o, _lru_cache_wrapper)]
            _caches[:] = [item.path, *(o for o in found if (o.__module__ or "").startswith(OWN))]
        for cache in _caches[1:]:
            cache.cache_clear()
        coverage.Coverage.current().switch_context(item.nodeid)
        began = _processor_time()
        try:
            return (yield)
        finally:
            _note(test=item.nodeid, fixtures=_fixtures(item), seconds=_processor_time() - began)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(fixturedef, request):
        """Attribute a fixture of many tests to itself."""
        measured = coverage.Coverage.current()
        if fixturedef.scope == "function" or measured is None:
            return (yield)
        measured.switch_context(f"fixture {fixturedef.baseid}::{fixturedef.argname}")
        try:
            return (yield)
        finally:
            measured.switch_context(os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")[0])

    def pytest_runtest_logreport(report):
        """Keep how it ended, as the process tells that ran it."""
        if not hasattr(report, "node"):
            _note(test=report.nodeid, outcome=report.outcome)


if ORDER:

    def pytest_collection_modifyitems(config, items):
        """Keep the tests that execute the line, in the order chosen for them."""
        order = {name: i for i, name in enumerate(Path(ORDER).read_text().splitlines())}
        items[:] = sorted((i for i in items if i.nodeid in order), key=lambda i: order[i.nodeid])

    def _failed(report):
        if report.failed:
            Path(f"{ORDER}.failed").write_text(report.nodeid)

    pytest_runtest_logreport = pytest_collectreport = _failed
