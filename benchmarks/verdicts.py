"""Whether the word above a fit is worth its name: grades and intervals, where logs deceive.

python benchmarks/verdicts.py [--cells gusts variances] [--fits 20] [--seed 0] [--output FILE]

Every cell makes data that look like those of flights and benches, states a fit as a user would, and
knows the truth. Plants, gusts and loops are simulated here, by exact steps of linear systems or by
Runge-Kutta steps. *Silent* is an answer "good" over a value outside of its interval of 99 %
(Bonferroni), or over a model that is wrong: one that lacks something, or whose errors no model of
noise has. *Wrong* counts answers that the model does not explain the data. *Scolded* is another
answer of a right model whose values are all within these intervals. *Coverage* is the share of 95 %
intervals that hold the truth, where there is one. *Interval* is the factor of these intervals on
the standard error, its median and 95th percentile, which differ much where intervals are a lottery.
`--cells` takes beginnings of names.
"""

import argparse
import datetime as dt
import platform
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.stats import t as student

import greybox as gb
from greybox.assessment.verdict import verdict
from greybox.models.tilt import PAPER_G, LinearTilt, Tilt

Random = np.random.Generator
Values = Mapping[str, float]


@dataclass(frozen=True)
class Case:
    """A fit, the true values of its parameters, and whether its model is right."""

    fit: gb.Fit
    truth: Values
    is_right: bool = True


@dataclass(frozen=True)
class Cell:
    """A kind of data with what a user would state of it."""

    name: str
    make: Callable[[Random], Case]


def fitted(problem: Any, truth: Values, *, is_right: bool = True) -> Case:
    """Fit a problem from its declared values and one other start."""
    return Case(gb.fit(problem, starts=2, progress=False), truth, is_right)


def held_steps(dynamics: Any, inputs: Any, step: float) -> tuple[Any, Any]:
    """Return the matrices of one step of x' = A x + B u for a held input."""
    states, count = len(dynamics), inputs.shape[1]
    matrix = np.zeros((states + count, states + count))
    matrix[:states, :states] = dynamics
    matrix[:states, states:] = inputs
    exact = expm(step * matrix)
    return exact[:states, :states], exact[:states, states:]


# A quadrotor in gusts: (4.23) with linear drag, its angle, rate and velocity logged, under control.

TILT = {"a1": -14.61, "a2": 2.97, "a3": 8.47, "a4": 295.5}
DRAG, ROTOR = 0.16, 0.048  # 1/s, s
GUST_TIME = 1.5  # s, of light turbulence near the ground at hover
ANGLE_NOISE, GYRO_NOISE, VELOCITY_NOISE = 0.001, 0.05, 0.05  # rad, rad/s, m/s
VELOCITY_GAIN, ANGLE_GAIN, RATE_GAIN = 0.1, 6.0, 0.06  # rad s/m, 1/s, s


class TiltWithGyro(LinearTilt):
    """Angle, rate and velocity from the control, (4.23) with (4.24)."""

    outputs = ("theta", "q", "v")

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the outputs."""
        return (x.theta, x.q, x.v)


def tilt_record(random: Random, rate: float, gust: float, seconds: float = 60) -> gb.Record:
    """Return a flight under control with sines on its setpoint, in gusts of this size in m/s."""
    step = 1 / rate
    samples = round(seconds * rate)
    a1, a2, a3, a4 = TILT.values()
    dynamics = np.array(
        [
            [-DRAG, 0, PAPER_G, 0, DRAG],
            [-a3, -a2, -a1, a4, a3],
            [0, 1, 0, 0, 0],
            [0, 0, 0, -1 / ROTOR, 0],
            [0, 0, 0, 0, -1 / GUST_TIME],
        ]
    )
    by_control = np.array([[0], [0], [0], [1 / ROTOR], [0]])
    advance, response = held_steps(dynamics, by_control, step)
    white = gust * np.sqrt(1 - np.exp(-2 * step / GUST_TIME)) * random.normal(size=samples)
    time = step * np.arange(samples)
    omega = np.array([0.5, 0.9, 1.5, 2.3, 3.5, 5.0])
    phases = random.uniform(0, 2 * np.pi, omega.size)
    setpoint = 0.04 * np.sin(omega[:, None] * time + phases[:, None]).sum(axis=0)
    sizes = np.array([[ANGLE_NOISE], [GYRO_NOISE], [VELOCITY_NOISE]])
    sensors = sizes * random.normal(size=(3, samples))

    x = np.zeros(5)
    control, angle, rotation, velocity = np.zeros((4, samples))
    for k in range(samples):
        angle[k], rotation[k], velocity[k] = x[[2, 1, 0]] + sensors[:, k]
        wanted = ANGLE_GAIN * (setpoint[k] - VELOCITY_GAIN * velocity[k] - angle[k])
        control[k] = RATE_GAIN * (wanted - rotation[k])
        x = advance @ x + response[:, 0] * control[k]
        x[4] += white[k]

    signals = {"u": control, "theta": angle, "q": rotation, "v": velocity}
    return gb.Record(time, signals, hold={"u": np.inf})


def in_gusts(rate: float, gust: float, criterion: Any) -> Callable[[Random], Case]:
    """Return a cell of flights in gusts."""

    def make(random: Random) -> Case:
        problem = gb.Problem(
            TiltWithGyro(), tilt_record(random, rate, gust), criterion, fixed={"T_delay": 0.0}
        )
        return fitted(problem, TILT)

    return make


OTHER_CRITERIA: dict[str, gb.TimeCriterion] = {
    "output error": gb.OutputError(),
    "colored on q": gb.PredictionError(disturbance={"q": "colored"}),
}


# Few points of a response with variances that its file states.

POINT_ERRORS = 0.01, 0.17  # relative, at the lowest and at the highest frequency


def few_points(count: int, criterion: Any) -> Callable[[Random], Case]:
    """Return a cell of responses whose errors differ in size, as their file says."""

    def make(random: Random) -> Case:
        omega = np.geomspace(1.5, 15, count)
        s = 1j * omega
        tilt = (s + DRAG) / (
            (s + DRAG) * (s**2 + TILT["a2"] * s + TILT["a1"]) + PAPER_G * TILT["a3"]
        )
        response = TILT["a4"] * tilt / (ROTOR * s + 1) * np.exp(-0.0042 * s)
        size = np.abs(response) * np.geomspace(*POINT_ERRORS, count)
        errors = size * (random.normal(size=(count, 2)) @ [1, 1j]) / np.sqrt(2)
        data = gb.FrequencyResponse(omega, response + errors, "u", "theta", variance=size**2)
        return fitted(gb.Problem(Tilt(), data, criterion), TILT)

    return make


# A spring on a bench, whose force and position are logged.

SPRING = {"k": 25.0, "d": 2.0, "b": 25.0}
SPRING_STEP, SPRING_SAMPLES = 0.03, 1000  # s


class Spring(gb.StateSpace):
    """x'' = b u - k x - d x'."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    k = gb.Parameter(20.0, bounds=(0, 500))
    d = gb.Parameter(1.0, bounds=(0, 500))
    b = gb.Parameter(20.0, bounds=(0, 500))

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative."""
        return (x.v, p.b * u.u - p.k * x.x - p.d * x.v)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the output."""
        return (x.x,)


Acceleration = Callable[[float, float, float, float], float]
"""Of time, input, position and velocity."""


def right_spring(t: float, u: float, x: float, v: float) -> float:
    """Return the acceleration of the model itself."""
    return SPRING["b"] * u - SPRING["k"] * x - SPRING["d"] * v


def moved(acceleration: Acceleration, u: Any) -> Any:
    """Return the positions (n,) of a mass under a held force u (n,), by Runge-Kutta steps."""
    h = SPRING_STEP
    positions = np.zeros(len(u))
    x = v = 0.0
    for k, force in enumerate(u):
        positions[k] = x
        t = k * h
        v1, a1 = v, acceleration(t, force, x, v)
        v2, a2 = v + h / 2 * a1, acceleration(t + h / 2, force, x + h / 2 * v1, v + h / 2 * a1)
        v3, a3 = v + h / 2 * a2, acceleration(t + h / 2, force, x + h / 2 * v2, v + h / 2 * a2)
        v4, a4 = v + h * a3, acceleration(t + h, force, x + h * v3, v + h * a3)
        x += h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
        v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return positions


def steps(random: Random) -> Any:
    """Return a force (n,) that steps every 0.9 s."""
    return np.repeat(random.uniform(-1, 1, SPRING_SAMPLES // 30 + 1), 30)[:SPRING_SAMPLES]


def spring_case(u: Any, measured: Any, *, is_right: bool) -> Case:
    """Fit a linear spring by output error."""
    time = SPRING_STEP * np.arange(len(u))
    record = gb.Record(time, {"u": u, "x": measured}, hold={"u": np.inf})
    return fitted(gb.Problem(Spring(), record), SPRING, is_right=is_right)


def wrong_spring(acceleration: Callable[[Random], Acceleration], above: float) -> Any:
    """Return a cell of another plant, whose best linear spring leaves `above` times the noise.

    The effect of what the model lacks is the difference from the right plant, less what a spring
    of other values could follow: its size is that of the residuals of a fit without noise.
    """

    def make(random: Random) -> Case:
        u = steps(random)
        x = moved(acceleration(random), u)
        exact = spring_case(u, x, is_right=False).fit
        missed = exact.records[0].residual("x")
        noise = np.nanstd(missed) / above * random.normal(size=len(u))
        # No value of the model is the true one.
        return replace(spring_case(u, x + noise, is_right=False), truth={})

    return make


def varying(random: Random) -> Acceleration:
    """Return a spring whose stiffness varies by 15 % in sines."""
    omega, phase = random.uniform(0.3, 3), random.uniform(0, 2 * np.pi)

    def acceleration(t: float, u: float, x: float, v: float) -> float:
        stiffness = SPRING["k"] * (1 + 0.15 * np.sin(omega * t + phase))
        return SPRING["b"] * u - stiffness * x - SPRING["d"] * v

    return acceleration


def hardening(random: Random) -> Acceleration:
    """Return the spring of Duffing, which hardens."""

    def acceleration(t: float, u: float, x: float, v: float) -> float:
        return SPRING["b"] * u - SPRING["k"] * (x + 2 * x**3) - SPRING["d"] * v

    return acceleration


def hysteretic(random: Random) -> Acceleration:
    """Return the spring with elements of Jenkins beside it, which stick and slip."""
    slips = random.uniform(0.05, 0.4, 3)
    held = np.zeros(3)

    def acceleration(t: float, u: float, x: float, v: float) -> float:
        # The elements move with the calls, whose positions go back by less than a step.
        held[:] = np.clip(held, x - slips, x + slips)
        return right_spring(t, u, x, v) - 2.0 * float(np.sum(x - held))

    return acceleration


def spring_with(errors: Callable[[Random, int], Any], *, is_right: bool) -> Any:
    """Return a cell of the right spring with errors (n,) of about one fiftieth of its motion."""

    def make(random: Random) -> Case:
        u = steps(random)
        x = moved(right_spring, u)
        return spring_case(u, x + 0.02 * np.std(x) * errors(random, len(u)), is_right=is_right)

    return make


def white(random: Random, count: int) -> Any:
    """Return white errors."""
    return random.normal(size=count)


def autoregressive(random: Random, count: int) -> Any:
    """Return errors with a correlation of 0.85 from sample to sample."""
    return lfilter([np.sqrt(1 - 0.85**2)], [1, -0.85], random.normal(size=count + 100))[100:]


def drifting(random: Random, count: int) -> Any:
    """Return white errors on a slow random walk."""
    return random.normal(size=count) + 0.1 * np.cumsum(random.normal(size=count))


def with_line(random: Random, count: int) -> Any:
    """Return white errors with an aliased line of six times their size."""
    omega, phase = random.uniform(0.3, 2.8), random.uniform(0, 2 * np.pi)
    return random.normal(size=count) + 6 * np.sqrt(2) * np.sin(omega * np.arange(count) + phase)


def noisy_input(share: float) -> Callable[[Random], Case]:
    """Return a cell of forces that are measured with noise, and positions with 1 % of noise."""

    def make(random: Random) -> Case:
        u = steps(random) + 0.3 * lfilter([0.3], [1, -0.7], random.normal(size=SPRING_SAMPLES))
        x = moved(right_spring, u)
        measured = u + share * np.std(u) * random.normal(size=len(u))
        noise = 0.01 * np.std(x) * random.normal(size=len(u))
        return spring_case(measured, x + noise, is_right=True)

    return make


def in_slow_gusts(random: Random) -> Case:
    """Move the spring by gusts of a tenth of the force, which last 1.5 s."""
    u = steps(random)
    gust = lfilter([1.0], [1, -np.exp(-SPRING_STEP / GUST_TIME)], random.normal(size=len(u)))
    force = u + 0.1 * np.std(u) * gust / np.std(gust)
    x = moved(right_spring, force)
    return spring_case(u, x + 0.02 * np.std(x) * random.normal(size=len(u)), is_right=True)


# A spring with a delay, known by a response or through an angle of a log.


class LateSpring(gb.TransferFunction):
    """A spring with a delay."""

    input, output = "u", "x"
    k = gb.Parameter(20.0, bounds=(0, 500))
    d = gb.Parameter(1.0, bounds=(0, 500))
    b = gb.Parameter(20.0, bounds=(0, 500))
    tau = gb.Parameter(0.01, bounds=(0, 0.2), unit="s")

    def response(self, s: Any, p: Any) -> Any:
        """Return the response."""
        return p.b / (s**2 + p.d * s + p.k) * gb.exp(-s * p.tau)


def unstated_hold(random: Random) -> Case:
    """Measure a response through a control that is held for 20 ms, which nobody states."""
    omega, step, delay = np.geomspace(0.8, 20, 25), 0.02, 0.03
    s = 1j * omega
    hold = (1 - np.exp(-step * s)) / (step * s)
    plant = SPRING["b"] / (s**2 + SPRING["d"] * s + SPRING["k"]) * np.exp(-delay * s)
    errors = 0.01 * (random.normal(size=(len(s), 2)) @ [1, 1j])
    data = gb.FrequencyResponse(omega, plant * hold * (1 + errors), "u", "x")
    return fitted(gb.Problem(LateSpring(), data), {**SPRING, "tau": delay})


def truncated(random: Random) -> Case:
    """Truncate an angle of 0.02 in size to multiples of 0.0017, a tenth of a degree."""
    u = steps(random)
    x = 0.02 * moved(right_spring, u) / 0.4
    grid = np.deg2rad(0.1)
    time = SPRING_STEP * np.arange(len(u))
    signals = {"u": 0.05 * u, "x": np.trunc(x / grid) * grid}
    record = gb.Record(time, signals, hold={"u": np.inf})
    return fitted(gb.Problem(Spring(), record), SPRING)


def cells() -> Iterator[Cell]:
    """Yield all cells."""
    for rate in (100, 400):
        for gust in (0.0, 0.1, 0.5):
            yield Cell(f"gusts {gust:g} m/s, {rate} Hz", in_gusts(rate, gust, gb.PredictionError()))
        for words, criterion in OTHER_CRITERIA.items():
            yield Cell(f"gusts 0.1 m/s, {rate} Hz, {words}", in_gusts(rate, 0.1, criterion))
    for count in (5, 7, 10):
        yield Cell(f"variances of {count} points, default", few_points(count, None))
    yield Cell("variances of 5 points, likelihood", few_points(5, gb.MaximumLikelihood()))
    for above in (3, 10):
        yield Cell(f"varying stiffness, {above} noise", wrong_spring(varying, above))
        yield Cell(f"hysteresis, {above} noise", wrong_spring(hysteretic, above))
        yield Cell(f"Duffing, {above} noise", wrong_spring(hardening, above))
    yield Cell("line, aliased", spring_with(with_line, is_right=False))
    for share in (0.0, 0.05, 0.2):
        yield Cell(f"input with noise of {100 * share:.0f} %", noisy_input(share))
    yield Cell("hold unstated", unstated_hold)
    yield Cell("truncated angle", truncated)
    yield Cell("right, white", spring_with(white, is_right=True))
    yield Cell("right, autoregressive", spring_with(autoregressive, is_right=True))
    yield Cell("right, drifting", spring_with(drifting, is_right=True))
    yield Cell("right, slow gusts", in_slow_gusts)


HEADER = (
    f"{'cell':<42}{'good':>5}{'doubt':>6}{'poor':>5}{'wrong':>6}{'silent':>7}{'scolded':>8}"
    f"{'coverage':>9}"
    f"{'interval':>14}"
)


def row(cell: Cell, fits: int, seed: int) -> str:
    """Return the line of a cell."""
    grades = Counter[str]()
    silent = scolded = wrong = 0
    hits: list[bool] = []
    factors = []

    for number in range(fits):
        case = cell.make(np.random.default_rng([seed, number]))
        fit = case.fit
        grade = verdict(fit).grade
        grades[grade] += 1
        if grade == "failed":
            continue

        names = [name for name in case.truth if fit.standard_error[name] > 0]
        away = [
            abs(fit.estimate[name] - case.truth[name]) / fit.standard_error[name] for name in names
        ]
        factor = student.ppf(0.975, fit.dof)
        beyond = student.ppf(1 - 0.005 / max(len(names), 1), fit.dof)
        is_far = max(away, default=0.0) > beyond
        hits += [distance < factor for distance in away]
        factors.append(factor)
        wrong += bool(fit.misfit and not fit.misfit.explains)
        silent += grade == "good" and (is_far or not case.is_right)
        scolded += grade != "good" and not is_far and case.is_right

    coverage = f"{100 * np.mean(hits):.0f}%" if hits else "-"
    width = f"{np.median(factors):.1f} to {np.percentile(factors, 95):.1f}" if factors else "-"
    return (
        f"{cell.name:<42}{grades['good']:5d}{grades['doubt']:6d}{grades['poor']:5d}{wrong:6d}"
        f"{silent:7d}{scolded:8d}{coverage:>9}{width:>14}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", nargs="+", default=[""])
    parser.add_argument("--fits", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()

    lines = [
        f"greybox {gb.__version__}, {dt.date.today()}, Python {platform.python_version()}, numpy "
        f"{np.__version__}, {options.fits} fits a cell, seed {options.seed}",
        HEADER,
    ]
    print("\n".join(lines), flush=True)
    began = perf_counter()
    for cell in cells():
        if cell.name.startswith(tuple(options.cells)):
            lines.append(row(cell, options.fits, options.seed))
            print(lines[-1], flush=True)

    lines.append(f"{perf_counter() - began:.0f} s")
    print(lines[-1])
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
