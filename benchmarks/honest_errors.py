"""Whether intervals contain the truth, or the answer says why not, if noise is not as assumed.

python benchmarks/honest_errors.py [--fits 200] [--systems first] [--seed 0]
    [--output benchmarks/results/honest_errors.txt]

Records of three plants are fitted by output error and responses of two plants by two criteria.
Three sets of plants, `first`, `second` and `third`, differ in length, step, test signal and size of
the errors, too; each is newer than the diagnostics that it judges. The noise is white and normal
("right"), or something else: gusts, drift, one half louder, heavy tails, spikes, outputs with
common errors; along frequency correlated, of unequal size, heavy tails. The third set has other
kinds: white gusts, slow gusts on every state, controllers that respond to slow errors or to gusts,
errors that grow, come in bursts, are means of samples or a vibration; along frequency means of
neighbors, one loud band, outliers, and given variances that are too small. A fit passes if the
intervals of all parameters contain the truth, at a level that makes this 95 % of fits (Bonferroni).
It warns if it has any warning except that on the number of starts. Of 200 fits with other noise at
least 190 should pass or warn, and of 200 right ones at most 10 should warn.
"""

import argparse
import datetime as dt
import platform
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

import greybox as gb

RIGHT = "right"
Random = np.random.Generator


class Setting(NamedTuple):
    """Plants and how they are measured; errors are relative to the size of the outputs."""

    record_models: tuple[type[gb.StateSpace], ...]
    response_models: tuple[type[gb.TransferFunction], ...]
    samples: int
    step: float
    held_samples: int
    omega: Any
    size: float
    in_time: Mapping[str, Callable[[Random, int, int], Any]]
    along_frequency: Mapping[str, Callable[[Random, int], Any]]
    with_variances: bool = False


class Motor(gb.StateSpace):
    """A direct-current motor with its speed and current."""

    states = outputs = ("w", "i")
    inputs = ("e",)
    J = gb.Parameter(2.0, bounds=(0.01, 50))
    B = gb.Parameter(1.0, bounds=(-5, 20))
    R = gb.Parameter(3.0, bounds=(0.01, 50))
    K = gb.Parameter(2.0, bounds=(0.01, 20))

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative."""
        return (p.K * x.i - p.B * x.w, p.J * u.e - p.R * x.i - p.K * x.w)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the outputs."""
        return (x.w, x.i)


class ShortPeriod(gb.StateSpace):
    """Angle of attack and pitch rate of an airplane, with its normal acceleration."""

    states, inputs = ("alpha", "q"), ("de",)
    outputs = ("alpha", "q", "az")
    Z = gb.Parameter(-1.0, bounds=(-8, 1))
    M_alpha = gb.Parameter(-6.0, bounds=(-60, 10))
    M_q = gb.Parameter(-1.5, bounds=(-12, 2))
    M_de = gb.Parameter(-10.0, bounds=(-90, 0))

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative."""
        return (p.Z * x.alpha + x.q, p.M_alpha * x.alpha + p.M_q * x.q + p.M_de * u.de)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the outputs."""
        return (x.alpha, x.q, 5.1 * p.Z * x.alpha)


class RollRate(gb.StateSpace):
    """The roll rate of a vehicle whose actuator is a lag."""

    states, inputs, outputs = ("p", "a"), ("u",), ("p",)
    L_p = gb.Parameter(-2.0, bounds=(-30, 3))
    L_a = gb.Parameter(20.0, bounds=(1, 200))
    T = gb.Parameter(0.15, bounds=(0.02, 1))

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative."""
        return (p.L_p * x.p + p.L_a * x.a, (u.u - x.a) / p.T)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the output."""
        return (x.p,)


class TwoLags(gb.TransferFunction):
    """Two lags."""

    input, output = "u", "y"
    K = gb.Parameter(2.0, bounds=(0.01, 100))
    T_1 = gb.Parameter(0.3, bounds=(0.1, 10))
    T_2 = gb.Parameter(0.05, bounds=(0.001, 0.1))

    def response(self, s: Any, p: Any) -> Any:
        """Return the response."""
        return p.K / ((p.T_1 * s + 1) * (p.T_2 * s + 1))


class Oscillator(gb.TransferFunction):
    """A damped oscillation with a delay."""

    input, output = "u", "y"
    w = gb.Parameter(5.0, bounds=(1, 30))
    zeta = gb.Parameter(0.5, bounds=(0.02, 2))
    tau = gb.Parameter(0.02, bounds=(0, 0.2))

    def response(self, s: Any, p: Any) -> Any:
        """Return the response."""
        return p.w**2 / (s**2 + 2 * p.zeta * p.w * s + p.w**2) * gb.exp(-s * p.tau)


class DutchRoll(gb.StateSpace):
    """Sideslip and yaw rate of an airplane, with its lateral acceleration."""

    states, inputs = ("beta", "r"), ("dr",)
    outputs = ("beta", "r", "ay")
    Y = gb.Parameter(-0.2, bounds=(-2, 0.5))
    N_beta = gb.Parameter(3.0, bounds=(-5, 40))
    N_r = gb.Parameter(-0.4, bounds=(-6, 1))
    N_dr = gb.Parameter(-2.0, bounds=(-30, 0))

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative."""
        return (p.Y * x.beta - x.r, p.N_beta * x.beta + p.N_r * x.r + p.N_dr * u.dr)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the outputs."""
        return (x.beta, x.r, 60.0 * p.Y * x.beta)


class Servo(gb.StateSpace):
    """The position of a body on a spring and a damper, moved by a force."""

    states, inputs, outputs = ("x", "v"), ("f",), ("x",)
    k = gb.Parameter(3.0, bounds=(0.1, 40))
    d = gb.Parameter(1.0, bounds=(0.01, 20))
    b = gb.Parameter(2.0, bounds=(0.1, 50))

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative."""
        return (x.v, p.b * u.f - p.k * x.x - p.d * x.v)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the output."""
        return (x.x,)


class TwoRooms(gb.StateSpace):
    """The temperatures of a heated room and of the room beside it."""

    states = outputs = ("warm", "cold")
    inputs = ("heat",)
    h = gb.Parameter(1.0, bounds=(0.01, 20))
    k = gb.Parameter(0.3, bounds=(0.01, 10))
    loss = gb.Parameter(0.4, bounds=(0.01, 10))

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative."""
        flow = p.k * (x.warm - x.cold)
        return (p.h * u.heat - flow - p.loss * x.warm, flow - p.loss * x.cold)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the outputs."""
        return (x.warm, x.cold)


class LeadLag(gb.TransferFunction):
    """A lead and a lag with a delay."""

    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0.05, 20))
    T_lead = gb.Parameter(0.8, bounds=(0.02, 10))
    T_lag = gb.Parameter(0.2, bounds=(0.01, 10))
    tau = gb.Parameter(0.02, bounds=(0, 0.5))

    def response(self, s: Any, p: Any) -> Any:
        """Return the response."""
        return p.K * (p.T_lead * s + 1) / (p.T_lag * s + 1) * gb.exp(-s * p.tau)


class IntegratingLag(gb.TransferFunction):
    """An attitude: the integral of a rate that lags behind its control."""

    input, output = "u", "y"
    K = gb.Parameter(3.0, bounds=(0.1, 100))
    damping = gb.Parameter(1.0, bounds=(0.01, 20))
    T = gb.Parameter(0.05, bounds=(0.001, 1))

    def response(self, s: Any, p: Any) -> Any:
        """Return the response."""
        return p.K / (s * (s + p.damping) * (p.T * s + 1))


class Heave(gb.StateSpace):
    """The vertical speed of a helicopter, with its acceleration."""

    states, inputs, outputs = ("w",), ("col",), ("w", "a_z")
    Z_w = gb.Parameter(-1.0, bounds=(-8, 1))
    Z_col = gb.Parameter(-4.0, bounds=(-60, 0))

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative."""
        return (p.Z_w * x.w + p.Z_col * u.col,)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the outputs."""
        return (x.w, p.Z_w * x.w + p.Z_col * u.col)


class FlexibleArm(gb.StateSpace):
    """The rate of a hub and the deflection of a flexible arm on it, moved by a torque."""

    states, inputs, outputs = ("r", "x", "v"), ("m",), ("r", "x")
    d = gb.Parameter(0.5, bounds=(0.01, 10))
    b = gb.Parameter(2.0, bounds=(0.1, 40))
    k = gb.Parameter(30.0, bounds=(2, 400))
    c = gb.Parameter(1.0, bounds=(0.01, 20))

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative."""
        push = p.k * x.x + p.c * x.v
        return (p.b * u.m - p.d * x.r + 0.2 * push, x.v, -p.b * u.m - push)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the outputs."""
        return (x.r, x.x)


class ThreeTanks(gb.StateSpace):
    """The levels of the first and the last of three tanks in a row."""

    states, inputs, outputs = ("one", "two", "three"), ("pump",), ("one", "three")
    b = gb.Parameter(1.0, bounds=(0.05, 20))
    k = gb.Parameter(1.0, bounds=(0.05, 20))
    loss = gb.Parameter(0.5, bounds=(0.02, 20))

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative."""
        first, second = p.k * (x.one - x.two), p.k * (x.two - x.three)
        return (p.b * u.pump - first, first - second, second - p.loss * x.three)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the outputs."""
        return (x.one, x.three)


class PitchRate(gb.TransferFunction):
    """Pitch rate of an airplane from its elevator."""

    input, output = "u", "y"
    K = gb.Parameter(2.0, bounds=(0.05, 100))
    z = gb.Parameter(1.0, bounds=(0.05, 20))
    w = gb.Parameter(3.0, bounds=(0.5, 30))
    zeta = gb.Parameter(0.6, bounds=(0.03, 2))

    def response(self, s: Any, p: Any) -> Any:
        """Return the response."""
        return p.K * (s + p.z) / (s**2 + 2 * p.zeta * p.w * s + p.w**2)


class Notch(gb.TransferFunction):
    """A lag with a pair of zeros beside a pair of poles, as of a flexible mode."""

    input, output = "u", "y"
    K = gb.Parameter(2.0, bounds=(0.05, 50))
    T = gb.Parameter(0.2, bounds=(0.01, 3))
    w = gb.Parameter(10.0, bounds=(5, 20))
    zeta = gb.Parameter(0.2, bounds=(0.01, 1))

    def response(self, s: Any, p: Any) -> Any:
        """Return the response."""
        zeros = s**2 + 2 * 0.05 * 9 * s + 81
        return p.K / (p.T * s + 1) * zeros / (s**2 + 2 * p.zeta * p.w * s + p.w**2)


TRUTH: dict[Any, Mapping[str, float]] = {
    Motor: {"J": 3.0, "B": 0.8, "R": 4.0, "K": 2.5},
    ShortPeriod: {"Z": -1.6, "M_alpha": -9.0, "M_q": -2.2, "M_de": -14.0},
    RollRate: {"L_p": -3.0, "L_a": 30.0, "T": 0.08},
    TwoLags: {"K": 4.0, "T_1": 0.5, "T_2": 0.03},
    Oscillator: {"w": 7.0, "zeta": 0.35, "tau": 0.035},
    DutchRoll: {"Y": -0.3, "N_beta": 5.0, "N_r": -0.6, "N_dr": -3.5},
    Servo: {"k": 5.0, "d": 1.4, "b": 4.0},
    TwoRooms: {"h": 1.5, "k": 0.5, "loss": 0.25},
    LeadLag: {"K": 1.3, "T_lead": 0.6, "T_lag": 0.12, "tau": 0.03},
    IntegratingLag: {"K": 6.0, "damping": 1.8, "T": 0.08},
    Heave: {"Z_w": -0.6, "Z_col": -7.0},
    FlexibleArm: {"d": 0.8, "b": 3.5, "k": 45.0, "c": 1.5},
    ThreeTanks: {"b": 1.4, "k": 1.7, "loss": 0.9},
    PitchRate: {"K": 3.0, "z": 0.7, "w": 4.0, "zeta": 0.4},
    Notch: {"K": 3.0, "T": 0.35, "w": 11.0, "zeta": 0.1},
}


def autoregression(white: Any, rho: float) -> Any:
    """Return stationary errors of variance one from white ones (..., n), of which 100 are lost."""
    return lfilter([np.sqrt(1 - rho**2)], [1, -rho], white)[..., 100:]


# Errors (k, n) of k outputs, of about size one.
IN_TIME: dict[str, Callable[[Random, int, int], Any]] = {
    RIGHT: lambda random, k, n: random.normal(size=(k, n)),
    "gusts": lambda random, k, n: random.normal(size=(k, n)),  # in the states, see `record`
    "drift": lambda random, k, n: (
        random.normal(size=(k, n)) + 0.15 * np.cumsum(random.normal(size=(k, n)), axis=1)
    ),
    "one half louder": lambda random, k, n: (
        random.normal(size=(k, n)) * np.where(np.arange(n) < n // 2, 1.0, 4.0)
    ),
    "heavy tails": lambda random, k, n: random.standard_t(3, (k, n)),
    "spikes": lambda random, k, n: (
        random.normal(size=(k, n))
        + 20 * random.normal(size=(k, n)) * (random.random((k, n)) < 0.02)
    ),
    "common errors": lambda random, k, n: 0.3 * random.normal(size=(k, n)) + random.normal(size=n),
    "slow errors": lambda random, k, n: autoregression(random.normal(size=(k, n + 100)), 0.9),
}


def circular(random: Random, n: int) -> Any:
    """Return circular errors of variance one."""
    return random.normal(size=(n, 2)) @ [1, 1j] / np.sqrt(2)


ALONG_FREQUENCY: dict[str, Callable[[Random, int], Any]] = {
    RIGHT: circular,
    "correlated": lambda random, n: autoregression(circular(random, n + 100), 0.7),
    "unequal sizes": lambda random, n: circular(random, n) * np.geomspace(0.3, 3, n),
    "heavy tails, response": lambda random, n: (
        circular(random, n) / np.sqrt(random.chisquare(3, n) / 3)
    ),
}


def bursts(random: Random, k: int, n: int) -> Any:
    """Return errors with five stretches of 15 samples that are eight times as large."""
    size = np.ones(n)
    for first in random.integers(0, n - 15, 5):
        size[first : first + 15] = 8
    return size * random.normal(size=(k, n))


def vibration(random: Random, k: int, n: int) -> Any:
    """Return white errors with a line at a fifth of the sampling rate."""
    phase = 2 * np.pi * (0.2 * np.arange(n) + random.random((k, 1)))
    return random.normal(size=(k, n)) + 3 * np.sin(phase)


def means(white: Any, count: int) -> Any:
    """Return moving averages of variance one of white errors (..., n + count - 1)."""
    return lfilter(np.ones(count) / np.sqrt(count), [1], white)[..., count - 1 :]


# Kinds with "loop" are under control, those with "gusts" have gusts in the states, see `record`.
OTHER_IN_TIME: dict[str, Callable[[Random, int, int], Any]] = {
    RIGHT: IN_TIME[RIGHT],
    "right, closed loop": IN_TIME[RIGHT],
    "white gusts": IN_TIME[RIGHT],
    "slow gusts, all states": IN_TIME[RIGHT],
    "gusts, closed loop": IN_TIME[RIGHT],
    "slow errors, closed loop": IN_TIME["slow errors"],
    "errors that grow": lambda random, k, n: random.normal(size=(k, n)) * np.linspace(0.3, 3, n),
    "bursts": bursts,
    "means of samples": lambda random, k, n: means(random.normal(size=(k, n + 3)), 4),
    "vibration": vibration,
}
OTHER_ALONG_FREQUENCY: dict[str, Callable[[Random, int], Any]] = {
    RIGHT: circular,
    "means of neighbors": lambda random, n: means(circular(random, n + 2), 3),
    "one loud band": lambda random, n: (
        circular(random, n) * np.where(np.arange(n) // (n // 4) == 1, 4.0, 1.0)
    ),
    "outliers": lambda random, n: (
        circular(random, n) + 10 * circular(random, n) * (random.random(n) < 0.06)
    ),
    "larger than stated": lambda random, n: 2.5 * circular(random, n),
}


SETTINGS = {
    "first": Setting(
        (Motor, ShortPeriod, RollRate),
        (TwoLags, Oscillator),
        samples=400,
        step=0.03,
        held_samples=16,
        omega=np.geomspace(0.4, 40, 24),
        size=0.05,
        in_time=IN_TIME,
        along_frequency=ALONG_FREQUENCY,
    ),
    "second": Setting(
        (DutchRoll, Servo, TwoRooms),
        (LeadLag, IntegratingLag),
        samples=300,
        step=0.05,
        held_samples=13,
        omega=np.geomspace(0.6, 25, 30),
        size=0.08,
        in_time=IN_TIME,
        along_frequency=ALONG_FREQUENCY,
    ),
    "third": Setting(
        (Heave, FlexibleArm, ThreeTanks),
        (PitchRate, Notch),
        samples=800,
        step=0.025,
        held_samples=21,
        omega=np.geomspace(0.3, 50, 36),
        size=0.06,
        in_time=OTHER_IN_TIME,
        along_frequency=OTHER_ALONG_FREQUENCY,
        with_variances=True,
    ),
}


def record(setting: Setting, model: Any, kind: str, random: Random) -> gb.Record:
    """Return a record of a plant under steps of random sign."""
    truth, n = TRUTH[model], setting.samples
    linear = gb.modeling.linearize(model(), truth)
    order = len(linear.A)
    augmented = np.zeros((order + 1, order + 1))
    augmented[:order, :order], augmented[:order, order:] = linear.A, linear.B
    augmented = expm(setting.step * augmented)
    held = setting.held_samples
    u = np.repeat(random.choice([-1.0, 1.0], n // held + 1), held)[:n]
    gust = np.zeros((n, order))
    if "gusts" in kind:
        color = {"white gusts": 0.0, "slow gusts, all states": 0.98}.get(kind, 0.94)
        count, size = (order, 0.1) if "all states" in kind else (1, 0.3)
        size *= np.abs(linear.B).max() * setting.step
        shocks = random.normal(size=(count, n + 100))
        gust[:, -count:] = size * autoregression(shocks, color).T
    # The size of the errors is that of the outputs without them.
    errors = setting.in_time[kind](random, len(model.outputs), n).T
    feedback = 0.0
    if "loop" in kind:
        _, outputs = responded(linear, augmented, u, gust, 0 * errors, 0.0)
        feedback = np.std(u) / np.std(outputs[:, 0]) * np.sign(linear.B[0, 0] * linear.C[0, 0])
    _, outputs = responded(linear, augmented, u, 0 * gust, 0 * errors, feedback)
    errors = setting.size * outputs.std(axis=0) * errors
    u, outputs = responded(linear, augmented, u, gust, errors, feedback)
    rows = (outputs + errors).T
    signals = {model.inputs[0]: u, **dict(zip(model.outputs, rows, strict=True))}
    return gb.Record(np.arange(n) * setting.step, signals)


def responded(linear: Any, step: Any, command: Any, gust: Any, errors: Any, gain: float) -> Any:
    """Return input (n,) and outputs (n, k) where a gain feeds back the first measured output."""
    u, outputs = command.copy(), np.zeros(errors.shape)
    order = gust.shape[1]
    x = np.zeros(order)
    for t in range(len(u)):
        if t:
            u[t] -= gain * (outputs[t - 1, 0] + errors[t - 1, 0])
        outputs[t] = linear.C @ x + linear.D[:, 0] * u[t]
        x = step[:order, :order] @ x + step[:order, order] * u[t] + gust[t]
    return u, outputs


def fitted_record(setting: Setting, kind: str, seed: int) -> tuple[gb.Fit, Mapping[str, float]]:
    """Fit a record of one of the plants by output error."""
    model = setting.record_models[seed % 3]
    data = record(setting, model, kind, np.random.default_rng([seed, len(kind)]))
    problem = gb.Problem(model(), data, gb.OutputError(inputs="held"))
    return gb.fit(problem, [{}], profiles=False, progress=False), TRUTH[model]


def fitted_response(setting: Setting, kind: str, seed: int) -> tuple[gb.Fit, Mapping[str, float]]:
    """Fit a response of one of the plants by one of two criteria."""
    model, omega = setting.response_models[seed % 2], setting.omega
    random = np.random.default_rng([seed, len(kind)])
    exact = gb.frequency_response(model(), TRUTH[model], omega).response
    measured = exact * (1 + setting.size * setting.along_frequency[kind](random, omega.size))
    variance = (setting.size * np.abs(exact)) ** 2 if setting.with_variances else None
    data = gb.FrequencyResponse(omega, measured, "u", "y", variance=variance)
    other = gb.MaximumLikelihood() if setting.with_variances else gb.RelativeLikelihood()
    criterion = (gb.RelativeError(), other)[seed // 2 % 2]
    problem = gb.Problem(model(), data, criterion)
    return gb.fit(problem, [{}], profiles=False, progress=False), TRUTH[model]


def holds(fit: gb.Fit, truth: Mapping[str, float]) -> bool:
    """Return whether the intervals of all parameters contain the truth."""
    intervals = fit.interval(1 - 0.05 / len(truth))
    return all(intervals[name][0] <= value <= intervals[name][1] for name, value in truth.items())


def said(fit: gb.Fit) -> list[str]:
    """Return the warnings but that on the number of starts."""
    return [text for text in fit.warnings if not text.startswith("one start only")]


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--fits", type=int, default=200)
    parser.add_argument("--systems", choices=SETTINGS, default="first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()

    setting = SETTINGS[options.systems]
    cells = [(kind, fitted_record) for kind in setting.in_time]
    cells += [(kind, fitted_response) for kind in setting.along_frequency]
    others = sum(not kind.startswith(RIGHT) for kind, _ in cells)
    lines = [
        f"greybox {gb.__version__}, Python {platform.python_version()}, numpy {np.__version__}, "
        f"{dt.date.today()}, {options.systems} systems, seeds from {options.seed}",
        f"{'noise':<26}{'fits':>6}{'hold':>6}{'speak':>7}{'hold or speak':>15}",
    ]
    total = {True: np.zeros(4, int), False: np.zeros(4, int)}
    for kind, fitted in cells:
        is_right = kind.startswith(RIGHT)
        count = -(-options.fits // (len(cells) - others if is_right else others))
        counts = np.zeros(4, int)
        for seed in range(options.seed, options.seed + count):
            fit, truth = fitted(setting, kind, seed)
            hold, speak = holds(fit, truth), bool(said(fit))
            counts += [1, hold, speak, hold or speak]
        total[is_right] += counts
        name = f"{kind}, {'record' if fitted is fitted_record else 'response'}"
        name = name if kind == RIGHT else kind
        lines.append(f"{name:<26}{counts[0]:>6}{counts[1]:>6}{counts[2]:>7}{counts[3]:>15}")
        print(lines[-1], flush=True)
    for is_right, name in ((True, "right noise, all"), (False, "other noise, all")):
        counts = total[is_right]
        lines.append(f"{name:<26}{counts[0]:>6}{counts[1]:>6}{counts[2]:>7}{counts[3]:>15}")

    print("\n".join(lines))
    if options.output:
        options.output.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
