"""The limits of the record solver's runs at a tenth and ten times, on 29 hard problems.

python benchmarks/ablation.py [--constants NAME ...] [--only PROBLEM ...] [--seeds 0 1 2]
    [--quick] [--output benchmarks/results/ablation.txt]

Every problem is fitted as a user would, `gb.fit(problem, starts=N, seed=s)`: from the declared
values and N - 1 Sobol points of the declared boxes, once for every seed, with the usual limits and
with others. The kept output also has the solver's strategies, one of them off at a time, which can
no longer be switched off. `--quick` takes the first seed and the problems of less than a second.
One process, one thread.

A run succeeds if it converged to the cost of the best known minimum, to within `within` (0.1: at
worst 0.45 standard errors along one direction); a fit, if its lowest minimum is that. A cost that
is lower by more is no success, since too coarse an integration may yield one, and is printed. The
best known costs are those of fits from the truth or the certified values and of 15 further Sobol
points, and of all runs of this benchmark. Times are of the processor. A difference counts as noise
where a sign test on the runs and fits that changed does not reject chance at 5 %.

The problems were chosen before anything was switched off, from `tests/support/hard_models.py`:
- those of `tests/engine/solve/test_hard_models.py`: tanks, guarded tanks (roots of levels, after
Wigren
  and Schoukens (2013), Three free data sets for development and benchmarking in nonlinear system
  identification), reactor (ignition), chain and unseen (unmeasured states), overflow (a limit that
  no start reaches), too simple (a wrong model, with diagonal and full covariance);
- those of `tests/engine/solve/test_published_cases.py` and the like: Lotka and Volterra, a pendulum
with
  two samples and a half a period, Lorenz (1963), a damped swing whose stiffnesses may swap, direct
  delay (the cost jumps), a long record;
- flights of the unstable tilt plant: output error in the declared boxes; with gusts that the model
  does not know of; as a predictor with twelve gains; as a predictor at its stability limit; and a
  spring predictor with an unknown force;
- stiff: a pole of 1000 1/s sampled at 20 Hz;
- those known to fail or to mislead: conversion (a spurious fast solution), thrust (initial states
  hardly seen), tanh chain (30 parameters for 12 states originally, here 15 for 6, poorly posed);
- NIST's Statistical Reference Datasets, https://www.itl.nist.gov/div898/strd/ (public domain, in
  `tests/data/nist`): Bennett5, MGH10, MGH17, Lanczos1, Lanczos2, Lanczos3.
"""

import argparse
import contextlib
import json
import math
import os
import platform
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "support"))

import hard_models as hard  # noqa: E402
import numpy as np  # noqa: E402

import greybox as gb  # noqa: E402
from greybox.engine.solve.gauss_newton.settings import Settings  # noqa: E402

LIMIT = 40  # s of one fit
BASE = "usual limits"


def table(name: str) -> np.ndarray:
    """Return y and x (n, 2) of one of NIST's files."""
    lines = (
        (HERE.parent / "tests" / "data" / "nist" / f"{name}.dat")
        .read_text(encoding="ascii")
        .splitlines()[60:]
    )
    return np.array([[float(value) for value in line.split()] for line in lines if line.strip()])


def lanczos(k: int) -> Any:
    return hard.nist(hard.Lanczos, table(f"Lanczos{k}"), e="b1", f="b3", g="b5")


@dataclass(frozen=True)
class Case:
    """A problem with its best known cost.

    `tags` has `quick` if it takes a moment.
    """

    make: Callable[[], Any]
    best: float
    starts: int = 6
    within: float = 0.1
    tags: str = ""


CASES = {
    "tanks": Case(hard.tanks, -1757.916, within=0.5),  # two minima 0.31 apart
    "guarded tanks": Case(lambda: hard.tanks(hard.GuardedTanks), -1757.916, within=0.5),
    "reactor": Case(hard.reactor, -541.510, 5),
    "chain": Case(hard.chain, -7791.318),
    "unseen": Case(hard.unseen, -622.943, tags="quick"),
    "overflow": Case(
        hard.overflow, -1750.0, 5, within=200.0
    ),  # RK4 cuts its kinks: the truth costs -1533 to -1908
    "too simple": Case(hard.too_simple, -831.726, tags="quick"),
    "too simple, full": Case(lambda: hard.too_simple("full"), -831.856, tags="quick"),
    "Lotka and Volterra": Case(hard.lotka_volterra, 78.682, tags="quick"),
    "pendulum": Case(hard.slow_pendulum, -199.013, tags="quick"),
    "Lorenz": Case(hard.lorenz, 284.452, tags="quick"),
    "swing": Case(hard.swing, -3107.470, tags="quick"),
    "direct delay": Case(hard.direct_delay, -1247.538, tags="quick"),
    "long": Case(hard.long_spring, -51295.166, 4),
    "tilt": Case(hard.tilt, -13531.344, tags="quick"),
    "tilt in wind, output error": Case(hard.tilt_in_wind_as_output_error, -2280.245),
    "tilt in wind, predictor": Case(hard.tilt_in_wind, -11303.759, 4),
    "blind tilt, predictor": Case(hard.blind_tilt, -22653.472, 3),
    "pushed spring, predictor": Case(hard.pushed, -7326.593, tags="quick"),
    "stiff": Case(hard.stiff_lag, -259.817, 4),
    "conversion": Case(hard.conversion, -30.825, tags="quick"),
    "thrust": Case(hard.thrust, -3769.902, 4),
    "tanh chain": Case(lambda: hard.tanh_chain(6, 400), -2565.151, 1, within=0.5),
    "Bennett5": Case(lambda: hard.nist(hard.Bennett5, table("Bennett5")), -750.981, tags="quick"),
    "MGH10": Case(lambda: hard.nist(hard.MGH10, table("MGH10")), 36.336, tags="quick"),
    "MGH17": Case(
        lambda: hard.nist(hard.MGH17, table("MGH17"), e="b2", f="b3"), -172.808, tags="quick"
    ),
    "Lanczos1": Case(lambda: lanczos(1), -473.063, tags="quick"),
    "Lanczos2": Case(lambda: lanczos(2), -298.400, tags="quick"),
    "Lanczos3": Case(lambda: lanczos(3), -219.403, tags="quick"),
}

CONSTANTS = tuple(f.name for f in fields(Settings))


@dataclass(frozen=True)
class Setting:
    """What one row of the table changes."""

    name: str
    options: dict[str, Any]


def varied(name: str) -> Iterator[Setting]:
    """Yield the settings with this constant at a tenth and at ten times its value."""
    value = getattr(Settings(), name)
    for changed in (value / 10, 10 * value):
        exact = max(int(changed), 1) if isinstance(value, int) else float(changed)
        yield Setting(f"{name} = {exact:g}", {name: exact})


# --- measuring


class TooLongError(Exception):
    """A fit took longer than LIMIT."""


def stop(*_: Any) -> None:
    raise TooLongError


def fitted(case: Case, problem: Any, options: dict[str, Any], seed: int) -> dict[str, Any]:
    """Fit once; return costs of runs (None if not converged) and fit, iterations, seconds."""
    began = time.process_time()
    signal.signal(signal.SIGALRM, stop)
    signal.alarm(LIMIT)
    runs: list[Any] = []
    cost, iterations, failure = math.nan, 0, ""
    try:
        settings = {"seed": seed, "solver_options": options, "progress": False}
        fit = gb.fit(problem, starts=case.starts or None, **settings)
        runs = [run.cost if run.converged else None for run in fit.runs[: case.starts]]
        cost, iterations = fit.cost, sum(run.iterations for run in fit.runs)
    except TooLongError:
        failure = "took too long"
    except Exception as error:
        failure = f"{type(error).__name__}: {error}"[:160]
    finally:
        signal.alarm(0)
    runs += [None] * (case.starts - len(runs))
    return {
        "runs": runs,
        "cost": cost,
        "iterations": iterations,
        "seconds": time.process_time() - began,
        "failure": failure,
    }


def reached(case: Case, cost: float | None) -> bool:
    return cost is not None and abs(cost - case.best) <= case.within


class Results:
    """All fits, by setting, problem and seed.

    Kept in a file of JSON lines if there is one, and read from it.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.fits: dict[tuple[str, str, int], dict[str, Any]] = {}
        if path and path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                entry = json.loads(line)
                self.fits[entry["setting"], entry["problem"], entry["seed"]] = entry

    def add(self, setting: Setting, name: str, problem: Any, seed: int) -> None:
        """Fit, unless that is in the file."""
        key = (setting.name, name, seed)
        if key in self.fits:
            return
        entry = {"setting": setting.name, "problem": name, "seed": seed}
        entry |= fitted(CASES[name], problem, setting.options, seed)
        self.fits[key] = entry
        if self._path:
            with open(self._path, "a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")

    def pairs(self, setting: str) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
        """Return the problem, the fit with the usual limits, and that with the setting."""
        found = []
        for (name, problem, seed), entry in self.fits.items():
            if name == setting and (base := self.fits.get((BASE, problem, seed))):
                found.append((problem, base, entry))
        return found


def runs_reached(name: str, entry: dict[str, Any], first: int) -> list[bool]:
    """Return which runs succeeded; the declared start counts for the first seed alone."""
    return [reached(CASES[name], cost) for cost in entry["runs"][entry["seed"] != first :]]


def chance(better: int, worse: int) -> float:
    """Return the two-sided probability of a sign test."""
    n, k = better + worse, min(better, worse)
    return min(1.0, 2 * sum(math.comb(n, i) for i in range(k + 1)) / 2**n) if n else 1.0


def row(results: Results, setting: str, first: int) -> list[str]:
    """Return the lines about one setting: pooled, and the problems on which it matters."""
    pairs = results.pairs(setting)
    if not pairs:
        return []
    problems: dict[str, list[Any]] = {}
    for name, base, entry in pairs:
        on, off = runs_reached(name, base, first), runs_reached(name, entry, first)
        fits = reached(CASES[name], base["cost"]), reached(CASES[name], entry["cost"])
        item = problems.setdefault(name, [[], [], [], [], 0.0, 0.0, "", 0, 0])
        for k, value in enumerate((on, off, [fits[0]], [fits[1]])):
            item[k] += value
        item[4] += base["seconds"]
        item[5] += entry["seconds"]
        item[6] = entry["failure"] or item[6]
        item[7] += base["iterations"]
        item[8] += entry["iterations"]
    pooled = [[value for item in problems.values() for value in item[k]] for k in range(4)]
    changed = []
    for x, y in ((pooled[0], pooled[1]), (pooled[2], pooled[3])):
        pairs = [*zip(x, y, strict=True)]
        changed.append(chance(sum(a > b for a, b in pairs), sum(a < b for a, b in pairs)))
    ratio = math.exp(np.mean([math.log(item[5] / item[4]) for item in problems.values()]))
    total = sum(item[5] for item in problems.values()) / sum(item[4] for item in problems.values())
    steps = sum(item[8] for item in problems.values()) / max(
        sum(item[7] for item in problems.values()), 1
    )
    lines = [
        f"{setting:<46} {share(pooled[0]):>5} {share(pooled[1]):>5} {changed[0]:6.3f}   "
        f"{share(pooled[2]):>5} "
        f"{share(pooled[3]):>5} {changed[1]:6.3f}   {ratio:5.2f} {total:5.2f} {steps:5.2f}   "
        f"{len(pooled[0])} runs, {len(pooled[2])} fits"
    ]
    for name, (
        on,
        off,
        fits_on,
        fits_off,
        seconds_on,
        seconds_off,
        failure,
        *_,
    ) in problems.items():
        slower = seconds_off / seconds_on
        if on != off or fits_on != fits_off or not 0.7 < slower < 1.4:
            lines.append(
                f"    {name:<30} runs {sum(on)} -> {sum(off)} of {len(on)}, fits {sum(fits_on)} -> "
                f"{sum(fits_off)} of "
                f"{len(fits_on)}, time x {slower:.2f}{f', {failure}' if failure else ''}"
            )
    return lines


def share(values: Sequence[bool]) -> str:
    return f"{np.mean(values):.0%}" if values else "-"


def report(results: Results, settings: Sequence[Setting], seeds: Sequence[int]) -> None:
    print("\nWith the usual limits: runs and fits at the best known minimum, seconds of one fit")
    names = [name for name in CASES if any(key[:2] == (BASE, name) for key in results.fits)]
    everything: list[list[bool]] = [[], []]
    for name in names:
        entries = [entry for key, entry in results.fits.items() if key[:2] == (BASE, name)]
        runs = [ok for entry in entries for ok in runs_reached(name, entry, seeds[0])]
        fits = [reached(CASES[name], entry["cost"]) for entry in entries]
        everything = [everything[0] + runs, everything[1] + fits]
        print(f"  {name:<30} {share(runs):>5} of {len(runs):<3} {share(fits):>5} of {len(fits)}   "
              f"{np.mean([e['seconds'] for e in entries]):7.2f} s   "
              f"{entries[0]['failure']}")  # fmt: skip
    print(
        f"  {'all':<30} {share(everything[0]):>5} of {len(everything[0])}, {share(everything[1])} "
        f"of fits"
    )
    print(
        "\nRuns and fits at the best known minimum: with the usual limits, with the setting, "
        "probability of the change"
    )
    print(
        "by chance; time of the setting over that with the usual limits: geometric mean over the "
        "problems, of the"
    )
    print("sums; and that of the iterations, which other work on the machine does not touch")
    print(
        f"{'':<46} {'base':>5} {'set':>5} {'chance':>6}   {'base':>5} {'set':>5} {'chance':>6}   "
        f"{'time':>5} {'sum':>5} {'iter':>5}"
    )
    for setting in settings:
        if setting.name != BASE:
            print("\n".join(row(results, setting.name, seeds[0])))
    lower = {}
    for (setting, name, _), entry in results.fits.items():
        if entry["cost"] < CASES[name].best - CASES[name].within:
            lower.setdefault((name, round(entry["cost"], 2)), setting)
    for (name, cost), setting in lower.items():
        print(f"!!! {name}: {cost}, below the best known {CASES[name].best} ({setting})")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--constants", nargs="*", choices=CONSTANTS, default=CONSTANTS)
    parser.add_argument("--only", nargs="+", choices=list(CASES), help="problems")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument(
        "--starts",
        type=int,
        help="of every fit, for all problems; 0: the default ones; needs its own --raw",
    )
    parser.add_argument(
        "--quick", action="store_true", help="one seed, and the problems of less than a second"
    )
    parser.add_argument(
        "--raw", type=Path, help="keep every fit there, and go on with what is there"
    )
    parser.add_argument("--output", type=Path, help="write there what is printed")
    options = parser.parse_args()
    names = options.only or [
        name for name, case in CASES.items() if "quick" in case.tags or not options.quick
    ]
    seeds = options.seeds[:1] if options.quick else options.seeds
    settings = [Setting(BASE, {})]
    if options.starts is not None:
        CASES.update({name: replace(case, starts=options.starts) for name, case in CASES.items()})
    settings += [setting for name in options.constants for setting in varied(name)]
    results = Results(options.raw)
    warnings.simplefilter("ignore")
    for seed in seeds:
        problems = {name: CASES[name].make() for name in names}
        for setting in settings:
            for name, problem in problems.items():
                results.add(setting, name, problem, seed)
    with contextlib.ExitStack() as stack:
        if options.output:
            file = stack.enter_context(open(options.output, "w", encoding="utf-8"))
            stack.enter_context(contextlib.redirect_stdout(file))
        print(f"{date.today()}, greybox-id {version('greybox-id')}, casadi {version('casadi')}, "
              f"numpy {version('numpy')}, python {platform.python_version()}, {processor()}, one "
              f"thread")  # fmt: skip
        print(f"{len(names)} problems, seeds {' '.join(map(str, seeds))}")
        report(results, settings, seeds)


def processor() -> str:
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    return platform.processor() or platform.machine()


if __name__ == "__main__":
    main()
