"""Measure the files of tests, and print those that are slow: the list `SLOW` of `core_tests.py`.

python tests/support/slow_files.py [tests/engine/solve]    # all tests take a quarter of an hour

A file is slow if the first cases of its tests take 0.12 s on average, in processor time: other work
on the machine hardly changes that. What the cases of a file share counts for the first of them.
"""

import os
import sys
import textwrap
from collections import defaultdict
from pathlib import Path

import pytest

SLOW = 0.12  # s


class Stopwatch:
    """A plugin that notes the processor time of the first case of every test."""

    def __init__(self):
        self.seconds = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        """Run a test, and note its time and that of the processes that it has ended."""
        began = sum(os.times()[:4])
        result = yield
        function = (item.path.stem, item.nodeid.partition("[")[0])
        self.seconds.setdefault(function, sum(os.times()[:4]) - began)
        return result


def main():
    watch = Stopwatch()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.chdir(Path(__file__).parents[2])
    pytest.main(["-n", "0", *sys.argv[1:]], plugins=[watch])
    by_file = defaultdict(list)
    for (name, _), seconds in watch.seconds.items():
        by_file[name.removeprefix("test_")].append(seconds)
    slow = [name for name, taken in by_file.items() if sum(taken) >= SLOW * len(taken)]
    sys.stdout.write("\n".join(["", *textwrap.wrap(" ".join(sorted(slow)), 98), ""]))


if __name__ == "__main__":
    main()
