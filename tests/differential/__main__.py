"""Run new random cases for a while, and print those that differ; see the docstring of the package."""

import argparse
import os
import sys
import time
from collections import Counter
from itertools import count
from pathlib import Path

# One thread of linear algebra: matrices are small. Set before NumPy is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# In place of this folder, whose files are modules of the package.
sys.path[0] = str(Path(__file__).resolve().parents[1])

from differential.cases import FAMILIES, OPEN, run  # noqa: E402


def main() -> int:
    """Run the cases; return 1 if one differs."""
    parser = argparse.ArgumentParser(description="Random cases of greybox against references.")
    parser.add_argument("--seed", type=int, help="of the cases; by default the time")
    parser.add_argument("--seconds", type=float, default=60.0, help="begin no case after this time")
    parser.add_argument(
        "--only",
        action="append",
        metavar="FAMILY",
        help=f"one of {', '.join(FAMILIES)}; may be repeated",
    )
    parser.add_argument(
        "--without-open", action="store_true", help="leave out families with open differences"
    )
    parser.add_argument("--case", type=int, help="repeat one case; needs --only")
    options = parser.parse_args()
    if options.case is not None and not options.only:
        parser.error("--case repeats a case of one family: add --only FAMILY")
    unknown = set(options.only or ()) - set(FAMILIES)
    if unknown:
        parser.error(f"{unknown.pop()!r} is not a family: use one of {', '.join(FAMILIES)}")

    families = options.only or [f for f in FAMILIES if not (options.without_open and f in OPEN)]
    if options.case is not None:
        found = run(families[0], options.case)
        print(found or f"{families[0]} {options.case}: no difference")
        return 1 if found else 0

    seed = options.seed if options.seed is not None else int(time.time())
    # NumPy's seeds are not negative; neighboring seeds of the command share no case.
    first = seed * 1_000_003 % 2**31
    began, made, different = time.monotonic(), Counter(), Counter()
    for number in count():
        if time.monotonic() - began > options.seconds:
            break
        family = families[number % len(families)]
        found = run(family, first + number)
        made[family] += 1
        if found:
            different[family] += 1
            print(found, flush=True)

    summary = f"{made.total()} random cases of {len(made)} families, seed {seed}: {different.total()} differ"
    details = ", ".join(f"{n} of {made[f]} {f}" for f, n in different.items())
    print(summary + (f" ({details})" if details else ""), file=sys.stderr)
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
