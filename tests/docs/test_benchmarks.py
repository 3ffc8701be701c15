"""The README of the benchmarks lists all of them, and the outputs that are kept."""

import re
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "benchmarks"
TEXT = (FOLDER / "README.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| (.+?) \| (.+) \| .+? \| (.+?) \|$", TEXT, re.MULTILINE)
# Parts of a benchmark: named with it, or the same for all.
PARTS = {"boards/command.py", "mutation_faults.py", "mutation_plugin.py", "mutation_server.py"}


def test_every_benchmark_has_a_row():
    listed = {name for row in ROWS for name in re.findall(r"`((?:boards/)?\w+\.py)", " ".join(row))}
    files = {path.relative_to(FOLDER).as_posix() for path in FOLDER.rglob("*.py")}
    assert listed == files - PARTS


def test_every_kept_output_has_a_row():
    listed = set()
    for _, _, outputs in ROWS:
        first, *others = re.findall(r"`(\w+)`", outputs) or [""]
        listed |= {first, *(f"{first}{ending}" for ending in others)}
    assert listed - {""} == {path.stem for path in (FOLDER / "results").glob("*.txt")}


def test_six_run_every_night():
    (block,) = re.findall(r"```bash\n(.*?)```", TEXT, re.DOTALL)
    commands = re.findall(r"^python benchmarks/(\w+\.py)", block, re.MULTILINE)
    assert len(commands) == 6
    assert all((FOLDER / command).exists() for command in commands)
