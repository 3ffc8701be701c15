"""Speed, reliability and accuracy of a fit in the time domain, against code written by hand.

python benchmarks/time_fit.py [--parts speed growth starts errors records] [--long]
                             [--output benchmarks/results/time_fit.txt]

The unstable tilt plant of `time_references.py`, three outputs, five parameters, 60 s at 100 Hz. The
rivals are one multiple-shooting NLP for IPOPT (twice: with CasADi's derivatives of the whole, and
with blocks placed by hand) and scipy.optimize.least_squares around segments of one second (from
measured and from unknown initial states).

Every figure comes from a fresh process: libraries are imported (what greybox imports of scipy when
a fit first needs it, too), everything else is cold and counts, from the arrays to the answer
(standard errors included for greybox, left out for the rivals). Times are the processor's, which
other work on the machine changes least. Peak memory is the whole process's, interpreter
and data included. Rounds alternate, ratios are taken within a round, all run on one thread.
`--long` goes on to 600 000 samples, where the NLP takes minutes and gigabytes, and gives the NLP
random starts, of which those that fail take up to half a minute. The part `records` holds a hundred
short records against one with as many samples and 99 gaps.
"""

import argparse
import contextlib
import gc
import json
import math
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from time_references import (
    GRAVITY,
    LOWER,
    NAMES,
    NOISE,
    SEGMENT,
    START,
    STEP,
    TRUTH,
    UPPER,
    Flight,
    NonlinearProgram,
    fly,
    segment_fit,
)

SAMPLES = 6000
SIZES = (6000, 60_000, 600_000)
LIMITS = {
    ("greybox", SAMPLES): 3.5,
    ("greybox", SIZES[-1]): 20.0,
}
POWER, MEGABYTES = 1.1, 1000.0
RECORDS, SHORT, RATIO = (
    100,
    1000,
    3.0,
)  # records, samples of each, and how much longer they may take than one with gaps
SAME = 1e-4  # of a standard error, between two answers that are one minimum
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

Case = Callable[[Flight, dict[str, Any]], dict[str, Any]]


# --- the cases, each in its own process


def greybox_case(flight: Flight, options: dict[str, Any]) -> dict[str, Any]:
    """Fit with greybox; the one place that names its interface."""
    # The rivals' processes do without them; those of scipy are what a fit imports, up to 0.4 s of
    # one process.
    import scipy.fft  # noqa: PLC0415
    import scipy.optimize  # noqa: PLC0415
    import scipy.special  # noqa: PLC0415
    import scipy.stats.qmc  # noqa: F401, PLC0415

    import greybox as gb  # noqa: PLC0415

    # `import greybox` is lazy: what a fit imports at its first use is library, too.
    assert all((gb.fit, gb.several, gb.MultipleShooting, gb.OutputError))

    class FastTilt(gb.StateSpace):
        """(4.23) of the paper, the rotor being much faster."""

        states = outputs = ("v", "q", "theta")
        inputs = ("u",)
        a1 = gb.Parameter(START[0], bounds=(LOWER[0], UPPER[0]), unit="1/s²")
        a2 = gb.Parameter(START[1], bounds=(LOWER[1], UPPER[1]), unit="1/s")
        a3 = gb.Parameter(START[2], bounds=(LOWER[2], UPPER[2]), unit="1/(m·s)")
        a4 = gb.Parameter(START[3], bounds=(LOWER[3], UPPER[3]), unit="1/s²")
        C_x = gb.Parameter(START[4], bounds=(LOWER[4], UPPER[4]), unit="1/m", scale="log")

        def derivative(self, x: Any, u: Any, p: Any) -> Any:
            return (
                GRAVITY * gb.tan(x.theta) - p.C_x * abs(x.v) * x.v,
                -p.a1 * x.theta - p.a2 * x.q - p.a3 * x.v + p.a4 * u.u,
                x.q,
            )

        def output(self, x: Any, u: Any, p: Any) -> Any:
            return (x.v, x.q, x.theta)

    began, clock = clear(), time.perf_counter()
    signals = {"u": flight.u, **dict(zip(NOISE, flight.y, strict=True))}
    time_base = STEP * np.arange(len(flight.u))
    criterion = gb.OutputError(noise=NOISE, inputs="held")
    if pieces := options.get("pieces"):  # of one flight, each with its own initial states
        cuts = np.arange(0, len(flight.u), len(flight.u) // pieces)[1:]
        gaps = SEGMENT * STEP * np.searchsorted(cuts, np.arange(len(flight.u)), "right")
        each = [np.split(values, cuts) for values in (time_base, *signals.values())]
        records = [
            gb.Record(row[0], dict(zip(signals, row[1:], strict=True)))
            for row in zip(*each, strict=True)
        ]
        whole = gb.Record(time_base + gaps, signals)
        model = FastTilt()
        problem = gb.Problem(model, whole, criterion=criterion)
        problem = problem if options["joined"] else gb.several(model, records, criterion=criterion)
    else:
        problem = gb.Problem(FastTilt(), gb.Record(time_base, signals), criterion=criterion)
    method = gb.MultipleShooting(segment=SEGMENT)
    one = [dict(zip(NAMES, START.tolist(), strict=True))]
    fit = gb.fit(problem, starts=options.get("starts") or one, method=method, progress=False)
    seconds = time.process_time() - began
    # The cost is the negative log-likelihood; without this constant it is half the sum of squares,
    # as the rivals' are.
    constant = len(flight.u) * sum(
        math.log(sigma) + math.log(2 * math.pi) / 2 for sigma in NOISE.values()
    )
    return {
        "seconds": seconds,
        "elapsed": time.perf_counter() - clock,
        "estimate": [fit.estimate[name] for name in NAMES],
        "standard_error": [fit.standard_error[name] for name in NAMES],
        "costs": [run.cost - constant if run.converged else None for run in fit.runs],
        "status": fit.runs[0].status,
        "iterations": max(run.iterations for run in fit.runs),
    }


def ipopt_case(flight: Flight, options: dict[str, Any]) -> dict[str, Any]:
    """Build and solve the NLP; more starts share what was built."""
    began = clear()
    program = NonlinearProgram(flight, blocks=options.get("blocks", False))
    built = time.process_time() - began
    runs = [program.solve(start) for start in starts_of(options)]
    seconds = time.process_time() - began
    best = min(runs, key=lambda run: run["cost"] if solved(run) else math.inf)
    costs = [run["cost"] if solved(run) else None for run in runs]
    more = {"standard_error": program.standard_errors().tolist()} if options.get("errors") else {}
    return best | more | {"seconds": seconds, "built": built, "costs": costs}


def scipy_case(flight: Flight, options: dict[str, Any]) -> dict[str, Any]:
    """Run least_squares around short segments."""
    import scipy.optimize  # noqa: PLC0415  (a script has it at its top)
    import scipy.sparse  # noqa: F401, PLC0415

    free = options.get("free", False)
    began = clear()
    runs = [
        segment_fit(flight, start, free, options.get("errors", False))
        for start in starts_of(options)
    ]
    seconds = time.process_time() - began
    costs = [run["cost"] for run in runs]
    best = min(runs, key=lambda run: math.inf if run["cost"] is None else run["cost"])
    return best | {"seconds": seconds, "costs": costs}


def clear() -> float:
    """Return the processor's time after a garbage collection, which takes up to 60 ms."""
    gc.collect()
    return time.process_time()


def solved(run: dict[str, Any]) -> bool:
    return run["status"] in ("Solve_Succeeded", "Solved_To_Acceptable_Level")


def starts_of(options: dict[str, Any]) -> np.ndarray:
    """Return START, or this many random starts within the bounds, C_x uniform in its logarithm."""
    if not options.get("starts"):
        return START[None]
    part = np.random.default_rng(0).random((options["starts"], len(START)))
    points = LOWER + part * (UPPER - LOWER)
    points[:, 4] = LOWER[4] * (UPPER[4] / LOWER[4]) ** part[:, 4]
    return points


CASES: dict[str, tuple[Case, dict[str, Any]]] = {
    "greybox": (greybox_case, {}),
    "greybox, one record with gaps": (greybox_case, {"pieces": RECORDS, "joined": True}),
    "greybox, many records": (greybox_case, {"pieces": RECORDS, "joined": False}),
    "IPOPT": (ipopt_case, {}),
    "IPOPT by blocks": (ipopt_case, {"blocks": True}),
    "scipy, measured heads": (scipy_case, {}),
    "scipy, unknown heads": (scipy_case, {"free": True}),
}


def peak() -> float:
    """Return the peak memory, MB (VmHWM of Linux: ru_maxrss would begin with the parent's)."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e6
    except OSError:
        import resource  # noqa: PLC0415  (not on Windows)

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
            1e6 if sys.platform == "darwin" else 1e3
        )


def be_the_child(case: str, path: str, options: str) -> None:
    """Do one case and print one line of JSON."""
    with np.load(path) as file:
        flight = Flight(u=file["u"], y=file["y"])
    function, fixed = CASES[case]
    found = function(flight, fixed | json.loads(options))
    print(json.dumps(found | {"megabytes": peak()}))


class Bench:
    """Runs cases in fresh processes, on records kept in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = {**os.environ, **THREADS, "XDG_CACHE_HOME": str(folder / "cache")}

    def record(self, samples: int, seed: int = 0) -> Path:
        """Return the file of a record, made in another process so that this one stays small."""
        path = self.folder / f"{samples}_{seed}.npz"
        if not path.exists():
            self._child("--make", str(path), str(samples), str(seed))
        return path

    def run(self, case: str, samples: int, seed: int = 0, **options: Any) -> dict[str, Any] | None:
        """Return what the case found, or None if it failed, having said so."""
        began = time.perf_counter()
        try:
            answer = self._child(
                "--case", case, str(self.record(samples, seed)), json.dumps(options)
            )
        except subprocess.CalledProcessError as error:
            last = (error.stderr or "").strip().splitlines()[-1:] or [
                f"exit status {error.returncode}"
            ]
            print(f"!!! {case}, {samples} samples: {last[0][:160]}")
            return None
        return json.loads(answer.splitlines()[-1]) | {"process": time.perf_counter() - began}

    def _child(self, *arguments: str) -> str:
        command = [sys.executable, __file__, *arguments]
        return subprocess.run(
            command, capture_output=True, text=True, check=True, env=self.environment
        ).stdout


# --- what is printed


def middle(values: Sequence[float], form: str = ".3f") -> str:
    """Return the median and the range."""
    return f"{statistics.median(values):{form}} ({min(values):{form}} to {max(values):{form}})"


def verdict(good: bool) -> str:
    return "met" if good else "MISSED"


def speed(
    bench: Bench, cases: Sequence[str], samples: int, rounds: int
) -> dict[str, list[dict[str, Any]]]:
    """Time every case in every round; print times, memory and ratios; return what was found."""
    print(f"\n{samples} samples, one start, {rounds} round{'s' * (rounds > 1)}")
    found: dict[str, list[dict[str, Any]]] = {case: [] for case in cases}
    failed: set[str] = set()
    for _ in range(rounds):
        for case in cases:
            if case in failed:
                continue
            answer = bench.run(case, samples)
            failed |= {case} if answer is None else set()
            found[case] += [] if answer is None else [answer]
    found = {case: answers for case, answers in found.items() if answers}
    for case, answers in found.items():
        print(f"  {case:<22} {middle([a['seconds'] for a in answers])} s, "
              f"{max(a['megabytes'] for a in answers):.0f} MB, {answers[0]['iterations']} "
              f"iterations, "
              f"{answers[0]['status']}")  # fmt: skip
    for case in found:
        if case.startswith("greybox"):
            ratios(found, case, samples)
    return found


def ratios(found: dict[str, list[dict[str, Any]]], case: str, samples: int) -> None:
    """Print how many times faster a case is than the rivals; the limit is that of the NLP."""
    for rival, answers in found.items():
        if rival.startswith("greybox"):
            continue
        values = [b["seconds"] / a["seconds"] for a, b in zip(found[case], answers, strict=False)]
        limit = LIMITS.get((case, samples)) if rival.startswith("IPOPT") else None
        said = (
            ""
            if limit is None
            else f", at least {limit:g}: {verdict(statistics.median(values) >= limit)}"
        )
        print(f"  {case} is {middle(values, '.2f')} times as fast as {rival}{said}")
    if samples == SIZES[-1]:
        used = max(answer["megabytes"] for answer in found[case])
        print(f"  {case}: {used:.0f} MB, under {MEGABYTES:.0f}: {verdict(used < MEGABYTES)}")


def same_minimum(bench: Bench, found: dict[str, list[dict[str, Any]]], samples: int) -> bool:
    """Compare every estimator of this cost with IPOPT, in standard errors of the 60 s record."""
    reference = bench.run("IPOPT by blocks", SAMPLES, errors=True)
    if reference is None or "IPOPT by blocks" not in found:
        print("!!! nothing to hold the minimum against: the NLP was not solved")
        return False
    sigma = np.array(reference["standard_error"]) * math.sqrt(SAMPLES / samples)
    exact = np.array(found["IPOPT by blocks"][0]["estimate"])
    agreed = True
    for case, answers in found.items():
        if case.startswith("scipy") or case == "IPOPT by blocks":
            continue
        away = max(
            np.max(np.abs(np.array(answer["estimate"]) - exact) / sigma) for answer in answers
        )
        agreed &= bool(away <= SAME)
        words = (
            "the same minimum"
            if away <= SAME
            else "!!! NOT THE SAME MINIMUM, the times do not compare"
        )
        print(f"  {case} and IPOPT by blocks: {away:.1e} standard errors apart: {words}")
        if case == "greybox" and samples == SAMPLES:
            wide = np.array(answers[0]["standard_error"]) / sigma
            print(
                f"  standard errors of greybox over those of the KKT matrix: {min(wide):.4f} to "
                f"{max(wide):.4f}"
            )
    return agreed


def growth(bench: Bench, cases: Sequence[str], sizes: Sequence[int], rounds: int) -> bool:
    """Time longer and longer records; print the power with which time grows."""
    agreed = True
    times: dict[str, dict[int, float]] = {case: {} for case in cases}
    for samples in sizes:
        found = speed(
            bench, cases, samples, min(rounds, {SIZES[1]: 2, SIZES[2]: 1}.get(samples, rounds))
        )
        agreed &= same_minimum(bench, found, samples)
        for case, answers in found.items():
            times[case][samples] = statistics.median(answer["seconds"] for answer in answers)
    print("\nGrowth: the slope of log time over log samples, all sizes; between the two largest")
    for case, seconds in times.items():
        if len(seconds) > 1:
            x, y = np.log(list(seconds)), np.log(list(seconds.values()))
            power, last = float(np.polyfit(x, y, 1)[0]), float((y[-1] - y[-2]) / (x[-1] - x[-2]))
            limit = (
                f", at most {POWER}: {verdict(power <= POWER)}"
                if case.startswith("greybox")
                else ""
            )
            print(f"  {case:<22} {power:.3f}; {last:.3f}{limit}")
    return agreed


def starts(bench: Bench, cases: Sequence[str], number: int) -> None:
    """Print the share of random starts within the bounds that reach 1 % of the best cost."""
    print(
        f"\n{number} random starts in the bounds, {SAMPLES} samples: share within 1 % of the "
        f"lowest cost; in all"
    )
    for case in cases:
        answer = bench.run(case, SAMPLES, starts=number)
        if answer is None:
            continue
        costs = np.array([math.inf if cost is None else cost for cost in answer["costs"]])
        reached = int(np.sum(costs <= 1.01 * costs.min())) if np.isfinite(costs.min()) else 0
        away = np.max(np.abs(np.array(answer["estimate"]) / TRUTH - 1))
        each, low = 1e3 * answer["seconds"] / len(costs), costs.min()
        print(f"  {case:<22} {reached} of {len(costs)} ({reached / len(costs):.0%}), "
              f"{answer['seconds']:.2f} s, "
              f"{each:.0f} ms a start; lowest cost {low:.3f}, at most {100 * away:.1f} % from the "
              f"truth")  # fmt: skip


def errors(bench: Bench, cases: Sequence[str], flights: int) -> None:
    """Print the errors over several flights, in percent and in the method's standard errors."""
    print(
        f"\nRoot mean square error of the parameters over {flights} flights, %; and in its own "
        f"standard errors"
    )
    print(
        f"  {'':<22} {'  '.join(f'{name:>6}' for name in NAMES)}    "
        f"{'  '.join(f'{name:>5}' for name in NAMES)}"
    )
    for case in cases:
        answers = [
            bench.run(case, SAMPLES, seed=seed, errors=True) for seed in range(1, flights + 1)
        ]
        answers = [answer for answer in answers if answer is not None]
        if not answers:
            continue
        off = np.array([answer["estimate"] for answer in answers]) - TRUTH
        sigma = np.array([answer["standard_error"] for answer in answers])
        percent, own = (np.sqrt(np.mean(a**2, axis=0)) for a in (100 * off / TRUTH, off / sigma))
        print(
            f"  {case:<22} {'  '.join(f'{a:6.3f}' for a in percent)}    "
            f"{'  '.join(f'{a:5.1f}' for a in own)}"
        )


def records(bench: Bench, rounds: int) -> None:
    """Print how much longer many short records take than one with as many samples and gaps."""
    one, many = "greybox, one record with gaps", "greybox, many records"
    for count in (1, 20):
        print(
            f"\n{RECORDS} records of {SHORT} samples, {count} start{'s' * (count > 1)}, {rounds} "
            f"rounds"
        )
        options = {} if count == 1 else {"starts": count}
        pairs = [
            [bench.run(case, RECORDS * SHORT, **options) for case in (one, many)]
            for _ in range(rounds)
        ]
        found = [(a, b) for a, b in pairs if a and b]
        for case, answers in zip((one, many), zip(*found, strict=True), strict=True):
            print(
                f"  {case:<30} {middle([a['seconds'] for a in answers])} s, "
                f"{answers[0]['megabytes']:.0f} MB"
            )
        values = [b["seconds"] / a["seconds"] for a, b in found]
        good = statistics.median(values) <= RATIO
        print(
            f"  many records take {middle(values, '.2f')} times as long, at most {RATIO:g}: "
            f"{verdict(good)}"
        )
        ends = [np.array([answer["estimate"], answer["standard_error"]]) for answer in found[0]]
        away = float(np.max(np.abs(ends[0][0] - ends[1][0]) / ends[0][1]))
        print(f"  estimates {away:.1e} standard errors apart, the noise being given")


def versions() -> str:
    names = ["casadi", "numpy", "scipy"]
    with contextlib.suppress(Exception):
        version("greybox-id")
        names.insert(0, "greybox-id")
    return ", ".join(f"{name} {version(name)}" for name in names)


def usable(case: str) -> bool:
    """Return whether greybox has this method, for a case of greybox."""
    if not case.startswith("greybox"):
        return True
    code = "import greybox as gb; gb.MultipleShooting, gb.OutputError"
    return (
        subprocess.run(
            [sys.executable, "-P", "-c", code], capture_output=True, check=False
        ).returncode
        == 0
    )


def main() -> int:
    if sys.argv[1:2] == ["--case"]:
        be_the_child(*sys.argv[2:])
        return 0
    if sys.argv[1:2] == ["--make"]:
        flight = fly(int(sys.argv[3]), int(sys.argv[4]))
        np.savez(sys.argv[2], u=flight.u, y=flight.y)
        return 0
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    every = ["speed", "growth", "starts", "errors", "records"]
    parser.add_argument("--parts", nargs="+", choices=every, default=every)
    plain = [case for case, (_, fixed) in CASES.items() if "pieces" not in fixed]
    parser.add_argument("--cases", nargs="+", choices=plain, default=plain)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--starts", type=int, default=40)
    parser.add_argument("--flights", type=int, default=8)
    parser.add_argument("--long", action="store_true", help="600 000 samples too")
    parser.add_argument("--output", type=Path, help="write there what is printed")
    options = parser.parse_args()
    with contextlib.ExitStack() as stack:
        if options.output:
            file = stack.enter_context(open(options.output, "w", encoding="utf-8"))
            stack.enter_context(contextlib.redirect_stdout(file))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        return report(Bench(folder), options)


def report(bench: Bench, options: argparse.Namespace) -> int:
    """Print all parts; return 1 if estimators of one cost found different minima."""
    print(
        f"{date.today()}, {versions()}, python {platform.python_version()}, {os.cpu_count()} "
        f"cores, one thread each"
    )
    cases = [case for case in options.cases if usable(case)]
    if missing := [case for case in options.cases if case not in cases]:
        print(
            f"!!! this greybox has no MultipleShooting and OutputError yet: {', '.join(missing)} "
            f"left out"
        )
    agreed = True
    sizes = SIZES if options.long else SIZES[:-1]
    if "growth" in options.parts:
        agreed = growth(bench, cases, sizes, options.rounds)
    elif "speed" in options.parts:
        agreed = same_minimum(bench, speed(bench, cases, SAMPLES, options.rounds), SAMPLES)
    cases = [case for case in cases if case != "IPOPT"]  # it finds what its twin finds
    if "starts" in options.parts:
        starts(bench, [c for c in cases if options.long or c != "IPOPT by blocks"], options.starts)
    if "errors" in options.parts:
        errors(bench, cases, options.flights)
    if "records" in options.parts:
        records(bench, options.rounds)
    return 0 if agreed else 1


if __name__ == "__main__":
    sys.exit(main())
