"""Random vehicles through `gb.identify`: how many models are right, and which say they are not.

Monte Carlo.

python benchmarks/random_vehicles.py [--count 60] [--seed 1] [--closed-loop] [--out FILE]

Every vehicle has one to four poles (real ones and oscillations), no or one integrator, none to two
zeros (some in the right half plane), a delay, a gain of either sign and of six decades. A chirp of
90 s drives it, and the output has noise of 2 % of its standard deviation. In closed loop, a random
controller that stabilizes it (PD with an integrator, PI without) feeds the noise back, and the
chirp is added to the control or to the setpoint.

A model is right if its structure is that of the vehicle, if its response is within 5 % of the true
one in the median over the band, or if its residuals are no larger than the noise. Printed: how many
are right; how many of the wrong ones say that they do not explain the data; and for the true
structures the share of 95 % intervals of coefficients and delay that hold the truth, and the rms of
the errors over the standard errors. Errors of one vehicle are correlated: few of them decide.
"""

import argparse
import datetime as dt
import platform
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import lsim

import greybox as gb
from greybox.data.record import Recording

BAND = (0.3, 30.0)  # rad/s, of the chirp
DURATION, RATE, NOISE = 90.0, 100.0, 0.02  # s, Hz, share of the output's standard deviation
AT_REST = 3.0  # s before and after the chirp
FINE = 10  # steps of the simulation in a sampling interval


class Vehicle(NamedTuple):
    """Coefficients of numerator and denominator, the highest power first and the denominator monic.

    Delay in s.
    """

    numerator: np.ndarray
    denominator: np.ndarray
    delay: float

    @property
    def orders(self):
        """Orders of denominator and numerator, and the number of integrators."""
        integrators = int(self.denominator[-1] == 0)
        return len(self.denominator) - 1, len(self.numerator) - 1, integrators

    def response(self, omega):
        """Return the true response at `omega` in rad/s."""
        s = 1j * omega
        ratio = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return ratio * np.exp(-s * self.delay)

    @property
    def values(self):
        """The coefficients by the names of `Polynomial`."""
        b = {f"b{k}": value for k, value in enumerate(self.numerator[::-1])}
        a = {f"a{k}": v for k, v in enumerate(self.denominator[:0:-1]) if k >= self.orders[2]}
        return b | a | {"T_delay": self.delay}


def vehicle(random):
    """Return a random vehicle whose poles and zeros are inside the band of the chirp."""
    inside = np.log([0.5, 15.0])
    count, integrators = random.integers(1, 5), random.integers(0, 2)
    poles = []
    while len(poles) < count:
        size = np.exp(random.uniform(*inside))
        if count - len(poles) > 1 and random.random() < 0.4:
            damping = random.uniform(0.15, 0.9)
            pole = size * (-damping + 1j * np.sqrt(1 - damping**2))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(-size)
    zeros = [
        random.choice([-1, -1, -1, 1]) * np.exp(random.uniform(*inside))
        for _ in range(random.integers(0, min(3, count + integrators)))
    ]
    denominator = np.real(np.poly([*poles, *[0.0] * integrators]))
    numerator = np.atleast_1d(np.real(np.poly(zeros)))
    gain = random.choice([-1, 1]) * 10 ** random.uniform(-3, 3)
    at_rest = numerator[-1] / denominator[-1 - integrators]
    return Vehicle(gain * numerator / at_rest, denominator, random.uniform(0, 0.06))


def chirp(time):
    """Return the control at any times; it is zero before and after, and fades in a second."""
    length = DURATION - 2 * AT_REST
    growth = np.log(BAND[1] / BAND[0])
    since = np.clip(time - AT_REST, 0, length)
    phase = BAND[0] * length / growth * np.expm1(growth * since / length)
    return np.clip(np.minimum(since, length - since), 0, 1) * np.sin(phase)


def flown(of, random):
    """Return the log of a chirp."""
    fine = np.arange(0, DURATION, 1 / (RATE * FINE))
    y = lsim((of.numerator, of.denominator), chirp(fine - of.delay), fine)[1][::FINE]
    y = y + NOISE * np.std(y) * random.standard_normal(y.size)
    time = fine[::FINE]
    return Recording({"log": gb.Record(time, {"u": chirp(time), "y": y})}, "made")


def controller(of, random):
    """Return the response of a random controller that stabilizes a vehicle, as a function of s."""
    omega = np.geomspace(1e-3, 300, 20_000)
    reach = np.exp(random.uniform(*np.log([0.5, 5.0])))  # rad/s, of its lead or lag
    if of.orders[2]:
        shape = lambda s: 1 + s / reach / (1 + s / reach / 10)  # noqa: E731
    else:
        shape = lambda s: 1 + 0.3 * reach / s  # noqa: E731
    sign = np.sign(of.numerator[-1])
    loop = sign * of.response(omega) * shape(1j * omega)
    # Without poles in the right half plane, it is stable up to the first gain at which it is not.
    crossing = (np.diff(np.sign(loop.imag)) != 0) & (loop.real[1:] < 0)
    least = np.min(np.abs(loop[omega < BAND[1]]))
    gain = sign * random.uniform(0.15, 0.5) / np.max(np.abs(loop[1:][crossing]), initial=least)
    return lambda s: gain * shape(s)


def flown_in_loop(of, random):
    """Return the log of a chirp in closed loop, and the injected signal.

    All signals begin and end at rest and are slow, so that their transforms are exact.
    """
    time = np.arange(0, DURATION, 1 / RATE)
    count = 4 * time.size
    s = 2j * np.pi * np.fft.rfftfreq(count, 1 / RATE)
    s[0] = 1e-6j
    plant, control = of.response(s.imag), controller(of, random)(s)
    at_setpoint = random.random() < 0.5
    injected = chirp(time)
    test = np.fft.rfft(injected, count)
    returns = 1 + plant * control
    quiet = np.fft.irfft(plant * (control if at_setpoint else 1) * test / returns, count)
    size = NOISE * np.std(quiet[: time.size])
    noise = np.fft.rfft(size * random.standard_normal(count))
    u = (control if at_setpoint else 1) * test - control * noise
    y = plant * (control if at_setpoint else 1) * test + noise
    u, y = (np.fft.irfft(x / returns, count)[: time.size] for x in (u, y))
    name = "r" if at_setpoint else "e"
    return Recording({"log": gb.Record(time, {"u": u, "y": y, name: injected})}, "made"), name


class Outcome(NamedTuple):
    """What came of a vehicle.

    The structure, the error of its response, its residuals over the noise.
    """

    is_true: bool
    error: float
    noise: float
    explains: bool
    held: tuple[bool, ...]
    scores: tuple[float, ...]
    text: str

    @property
    def is_right(self):
        """Whether the model is the vehicle's, or as good."""
        return self.is_true or self.error <= 0.05 or self.noise <= 1.2


def outcome(of, random, closed_loop=False):
    log, instrument = flown_in_loop(of, random) if closed_loop else (flown(of, random), "")
    # The sweep in a setpoint is found; a signal that is added to the control has to be named.
    options = {"instrument": f"log.{instrument}"} if instrument == "e" else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = gb.identify(log, input="u=log.u", output="y=log.y", whole=True, **options)
    if found.selection is None or found.fit is None:
        text = " ".join(found.refusals) or "no fit"
        return Outcome(False, np.inf, np.inf, False, (), (), f"refused: {text}")
    chosen, fit = found.selection.chosen, found.fit
    part = fit.responses[0]
    true = of.response(part.data.omega)
    error = float(np.median(np.abs(part.response / true - 1)))
    model = part.model["arguments"]
    is_true = tuple(int(v) for v in model[:3]) == of.orders
    intervals = fit.interval()
    judged = {name: value for name, value in of.values.items() if is_true and name in intervals}
    held = tuple(
        bool(intervals[name][0] <= value <= intervals[name][1]) for name, value in judged.items()
    )
    scores = tuple(
        (fit.estimate[name] - value) / fit.standard_error[name]
        for name, value in judged.items()
        if fit.standard_error[name] > 0
    )
    text = (
        f"{of.orders} -> {chosen.label}: error {100 * error:.2g} %, residual/noise "
        f"{chosen.noise:.2f}"
    )
    return Outcome(is_true, error, chosen.noise, found.selection.explains, held, scores, text)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--closed-loop", action="store_true")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    about = (
        f"greybox {version('greybox-id')}, Python {platform.python_version()}, numpy "
        f"{np.__version__}"
    )
    loop = "closed" if asked.closed_loop else "open"
    lines = [
        f"{asked.count} vehicles in {loop} loop, seed {asked.seed}; {about}, {dt.date.today()}"
    ]
    outcomes = []
    for k in range(asked.count):
        random = np.random.default_rng([asked.seed, k])
        of = vehicle(random)
        outcomes.append(outcome(of, random, asked.closed_loop))
        lines.append(f"{k:3} {outcomes[-1].text}")
        print(lines[-1], flush=True)
    lines += summary(outcomes)
    print(*lines[-5:], sep="\n")
    if asked.out:
        asked.out.write_text("\n".join(lines) + "\n")


def summary(outcomes):
    """Return the counts in words."""
    right = [o for o in outcomes if o.is_right]
    wrong = [o for o in outcomes if not o.is_right]
    held = [value for o in outcomes for value in o.held]
    scores = [value for o in outcomes for value in o.scores]
    size = f"{np.sqrt(np.mean(np.square(scores))):.2f}" if scores else "none"
    share = f"{100 * np.mean(held):.1f} % of {len(held)}" if held else "none"
    return [
        f"right: {len(right)} of {len(outcomes)}; of the true structure "
        f"{sum(o.is_true for o in outcomes)}, "
        f"within 5 % of the true response {sum(o.error <= 0.05 for o in outcomes)}",
        f"wrong ones that say so: {sum(not o.explains for o in wrong)} of {len(wrong)}",
        f"right ones that are called wrong: {sum(not o.explains for o in right)} of {len(right)}",
        f"intervals of the true structures that hold the truth: {share}",
        f"errors over standard errors, rms: {size}",
    ]


if __name__ == "__main__":
    main()
