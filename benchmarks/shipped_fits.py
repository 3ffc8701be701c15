"""Costs, estimates and standard errors of all shipped problems, to hold a change against.

python benchmarks/shipped_fits.py [--output FILE] [--against FILE] [--digits 9] [--only NAME ...]

Every problem is fitted with its own settings. `--against` compares with an earlier output and lists
the numbers that differ beyond the given number of significant digits; it exits with status 1 if
there are any. Both files must come from the same machine: another processor rounds differently.
"""

import argparse
import json
import math
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import greybox as gb
import greybox.problems


def numbers(name: str) -> dict[str, float]:
    """Return the numbers of one shipped problem: minima, estimates and standard errors."""
    module = import_module(f"greybox.problems.{name}")
    settings = {"starts": 50, "seed": 0} | dict(getattr(module, "settings", {}))
    fit = gb.fit(module.problem(), **settings)
    values = {"cost": fit.cost, "minima": float(len(fit.minima))}
    values |= {f"estimate {key}": value for key, value in fit.estimate.items()}
    values |= {f"error {key}": value for key, value in fit.standard_error.items()}
    return {key: float(value) for key, value in values.items()}


def differing(one: float, other: float, digits: int) -> bool:
    """Return whether two numbers differ in their first significant digits."""
    if math.isnan(one) or math.isnan(other):
        return math.isnan(one) != math.isnan(other)
    return abs(one - other) > 10.0**-digits * max(abs(one), abs(other))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--digits", type=int, default=9)
    parser.add_argument("--only", nargs="+", default=[])
    options = parser.parse_args()

    names = [m.name for m in iter_modules(greybox.problems.__path__) if m.name[0] != "_"]
    answers = {}
    for name in options.only or names:
        answers[name] = numbers(name)
        print(f"{name}: cost {answers[name]['cost']:.12g}", flush=True)
    if options.output:
        options.output.write_text(json.dumps(answers, indent=1))
    if not options.against:
        return 0

    earlier = json.loads(options.against.read_text())
    changed = [
        f"{name}, {key}: {earlier[name].get(key, math.nan):.12g} -> {value:.12g}"
        for name, values in answers.items()
        for key, value in values.items()
        if differing(earlier[name].get(key, math.nan), value, options.digits)
    ]
    print("\n".join(changed) or f"all equal to {options.digits} digits")
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main())
