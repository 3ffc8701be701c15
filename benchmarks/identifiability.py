"""Random structures with planted redundancies.

Whether they are named, and whether there are false alarms.

python benchmarks/identifiability.py [--planted 50] [--clean 200] [--output FILE]

The planted ones are products, ratios, powers and sums of parameters, dead parameters and confounded
biases of random models (`tests/support/random_structures.py`). Every warning of a fit without one
counts as a false alarm, and so does a note that names a combination. Exit status 1 if one is named
wrongly, or if more than one clean fit in twenty has one.
"""

import argparse
import datetime as dt
import sys
import time
from pathlib import Path

import greybox as gb

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from random_structures import KINDS, named_rightly, planted


def main() -> int:
    """Print what was named wrongly, and the false alarms."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--planted", type=int, default=50)
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()

    lines = [f"greybox {gb.__version__}, {dt.date.today()}"]
    wrong = 0
    for seed in range(options.planted):
        kind = KINDS[seed % len(KINDS)]
        truth = planted(kind, seed)
        error = named_rightly(gb.fit(truth.problem, 4, progress=False), truth)
        wrong += bool(error)
        if error:
            lines.append(f"{kind}, seed {seed}: {error}")
    lines.append(
        f"planted redundancies: {options.planted - wrong} of {options.planted} named rightly"
    )

    alarms, seconds = 0, 0.0
    for seed in range(1000, 1000 + options.clean):
        fit = gb.fit(planted("clean", seed).problem, 4, progress=False)
        began = time.perf_counter()
        combinations = fit.identifiability.combinations
        seconds += time.perf_counter() - began
        said = [*fit.warnings, *map(str, combinations)]
        alarms += bool(said)
        lines += [f"clean, seed {seed}: {text}" for text in said]
    lines.append(f"well-determined fits: {alarms} of {options.clean} with a warning")
    lines.append(f"identifiability of a fit: {1e3 * seconds / max(options.clean, 1):.2f} ms")

    text = "\n".join(lines)
    print(text)
    if options.output:
        options.output.write_text(text + "\n")
    return int(wrong > 0 or 20 * alarms > options.clean)


if __name__ == "__main__":
    sys.exit(main())
