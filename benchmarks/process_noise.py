"""Filter error: coverage of its intervals, and false alarms of the test for process noise.

python benchmarks/process_noise.py [--repeats 200] [--output benchmarks/results/process_noise.txt]

A spring (two outputs, noise on its velocity) and a lateral aircraft (five outputs, noise on three
states) are simulated exactly, with white noise on derivatives and sensors, and fitted with
`PredictionError(process_noise=...)` from the truth; the spring also in gusts of 0.5 s, with
`PredictionError(disturbance=...)`, and without it. Counted is how often the 95 % interval of every
parameter holds the truth. Then the spring without process noise: how often the test of output error
against filter error finds some, by one candidate and by two.
"""

import argparse
import datetime as dt
import platform
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

import greybox as gb

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from lateral_aircraft import LATERAL, Lateral, disturbed, doublets
from spring_lag_tilt import SPRING, Spring

TRUTH = {name: SPRING[name] for name in ("k", "c", "b")}
SENSORS = {"x": 0.05, "v": 0.15}
WIND = {"beta": 0.01, "p": 0.15, "r": 0.05}
AIRCRAFT = {"beta": 0.005, "p": 0.01, "r": 0.005, "phi": 0.004, "a_y": 0.02}


def fitted(model: Any, truth: Any, record: gb.Record, rule: Any) -> gb.Fit:
    return gb.fit(gb.Problem(model, record, rule), starts=[truth], progress=False)


def coverage(
    name: str, model: Any, truth: Any, process: Any, sensors: Any, size: Any, repeats: int
) -> str:
    began, hits, failed = time.perf_counter(), [], 0
    samples, step, amplitude = size
    wanted = (
        truth
        | {f"w_{n}": v for n, v in process.items()}
        | {f"v_{n}": v for n, v in sensors.items()}
    )
    rule = gb.PredictionError(process_noise=tuple(process), inputs="held")
    for seed in range(repeats):
        inputs = doublets(len(model.inputs), samples, amplitude, seed)
        fit = fitted(
            model, truth, disturbed(model, truth, inputs, step, process, sensors, seed), rule
        )
        if not fit.converged:
            failed += 1
            continue
        interval = fit.interval()
        hits.append([interval[n][0] <= value <= interval[n][1] for n, value in wanted.items()])
    share = 100 * np.mean(hits, axis=0)
    words = "  ".join(f"{n} {s:.1f}" for n, s in zip(wanted, share, strict=True))
    spent = time.perf_counter() - began
    return (
        f"{name}: {repeats} fits, {failed} failed, pooled {share.mean():.1f} %  [{spent:.0f} s]\n  "
        f"{words}"
    )


def gusts(rule: gb.PredictionError, repeats: int) -> str:
    """Coverage of the parameters of the spring in gusts of rms 1 and 0.5 s."""
    colored = gb.PredictionError(disturbance={"v": "colored"}, inputs="held")
    calm = disturbed(Spring(), TRUTH, doublets(1, 20, 1.0, 0), 0.05, {}, SENSORS, 0)
    flown = gb.Problem(Spring(), calm, colored).model
    truth, noise, hits, named = TRUTH | {"T_gust_v": 0.5}, {"gust_v": 2.0}, [], 0
    for seed in range(repeats):
        inputs = doublets(1, 1000, 1.0, seed)
        record = disturbed(flown, truth, inputs, 0.05, noise, SENSORS, seed)
        fit = fitted(Spring(), TRUTH, record, rule)
        named += any("as in gusts" in text for text in fit.warnings)
        interval = fit.interval()
        hits.append([interval[n][0] <= value <= interval[n][1] for n, value in TRUTH.items()])
    share = 100 * np.mean(hits, axis=0)
    words = "  ".join(f"{n} {s:.1f}" for n, s in zip(TRUTH, share, strict=True))
    what = "with" if rule.disturbance else "without"
    return (
        f"spring in gusts, {what} their state: {repeats} fits, pooled {share.mean():.1f} %, gusts "
        f"named in {named}\n  {words}"
    )


def named_gusts(samples: int, gust: float, color: float, repeats: int) -> str:
    """How often output error names gusts of 0.5 s, or noise of the sensors of this color."""
    colored = gb.PredictionError(disturbance={"v": "colored"}, inputs="held")
    calm = disturbed(Spring(), TRUTH, doublets(1, 20, 1.0, 0), 0.05, {}, SENSORS, 0)
    flown = gb.Problem(Spring(), calm, colored).model
    named = 0
    for seed in range(repeats):
        inputs = doublets(1, samples, 1.0, seed)
        truth = TRUTH | {"T_gust_v": 0.5}
        record = disturbed(flown, truth, inputs, 0.05, {"gust_v": gust}, SENSORS, seed)
        random = np.random.default_rng(seed)
        slow = {
            name: record[name] + lfilter([size], [1, -color], random.normal(size=samples))
            for name, size in SENSORS.items()
            if color
        }
        fit = fitted(Spring(), TRUTH, record.with_signals(**slow), gb.OutputError(inputs="held"))
        named += any("look like gusts" in text for text in fit.warnings)
    return (
        f"output error, {samples} samples, gusts of {gust:g}, noise of color {color:g}: gusts "
        f"named in {named} of {repeats}"
    )


def false_alarms(states: tuple[str, ...], repeats: int) -> str:
    values = []
    for seed in range(repeats):
        record = disturbed(Spring(), TRUTH, doublets(1, 600, 1.0, seed), 0.05, {}, SENSORS, seed)
        small = fitted(Spring(), TRUTH, record, gb.OutputError(inputs="held"))
        large = fitted(
            Spring(), TRUTH, record, gb.PredictionError(process_noise=states, inputs="held")
        )
        values.append(gb.validation.nested_test(small, large).p_value)
    share = [100 * np.mean(np.array(values) < level) for level in (0.05, 0.1)]
    found = f"{share[0]:.1f} % found at 5 %, {share[1]:.1f} % at 10 %"
    return f"no process noise, tested of {' and '.join(states)}: {repeats} records, {found}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [
        f"greybox {gb.__version__}, {dt.date.today()}, Python {platform.python_version()}, numpy "
        f"{np.__version__}"
    ]
    n = options.repeats
    cells = [(300, 2.0, 0.0), (1000, 2.0, 0.0), (300, 0.0, 0.0), (300, 0.0, 0.7), (1000, 0.0, 0.95)]
    for make in (
        lambda: coverage("spring", Spring(), TRUTH, {"v": 0.3}, SENSORS, (600, 0.05, 1.0), n),
        lambda: coverage(
            "lateral aircraft", Lateral(), LATERAL, WIND, AIRCRAFT, (500, 0.04, 0.1), n
        ),
        lambda: gusts(gb.PredictionError(disturbance={"v": "colored"}, inputs="held"), n),
        lambda: gusts(gb.PredictionError(inputs="held"), n),
        *(lambda cell=cell: named_gusts(*cell, n) for cell in cells),
        lambda: false_alarms(("v",), n),
        lambda: false_alarms(("x", "v"), n),
    ):
        lines.append(make())
        print(lines[-1], flush=True)
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
