"""A servo behind a dead zone and a saturation, fitted to describing functions by harmonic balance.

python benchmarks/describing_functions.py [--runs 5]

24 points, half of them at each of two amplitudes, two starts, four parameters. The measured
responses are first harmonics of simulations over 60 periods by SciPy, with errors of 0.5 %: the
estimates are held against the parameters of the simulation, in standard errors. The time is
processor time of `gb.fit` over that of a fit of the linear servo, without dead zone and
saturation, to as many points from as many starts; both are made in turn.
"""

import argparse
import time
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import greybox as gb

TRUTH = {"d": 4.0, "w": 20.0, "dead": 0.15, "limit": 0.5}
GAIN = 20.0
OMEGA = np.geomspace(1, 15, 12)
AMPLITUDES = (0.4, 1.5)
NOISE = 0.005
PERIODS, SAMPLES = 60, 4096


class LinearServo(gb.StateSpace):
    """A second-order lag, fed back."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    d = gb.Parameter(3.0, bounds=(0.1, 20), unit="1/s", about="damping")
    w = gb.Parameter(16.0, bounds=(1, 100), unit="1/s²", about="stiffness")

    def force(self, error, p):
        """Return the force over the gain."""
        return error

    def derivative(self, x, u, p):
        """Return speed and acceleration."""
        return (x.v, GAIN * self.force(u.u - 0.3 * x.x, p) - p.d * x.v - p.w * x.x)

    def output(self, x, u, p):
        """Return the position."""
        return (x.x,)


class Servo(LinearServo):
    """The same behind a dead zone and a saturation."""

    dead = gb.Parameter(0.1, bounds=(0, 0.5), about="half of the dead zone")
    limit = gb.Parameter(0.8, bounds=(0.3, 3), about="largest force")

    def force(self, error, p):
        """Return the force beyond the dead zone, up to the limit."""
        beyond = error - gb.minimum(gb.maximum(error, -p.dead), p.dead)
        return gb.minimum(gb.maximum(beyond, -p.limit), p.limit)


def simulated(omega: float, amplitude: float) -> complex:
    """Return the first harmonic of the last period of a simulation, over the amplitude."""
    end = 2 * np.pi * PERIODS / omega
    t = end - 2 * np.pi / omega * (1 - np.arange(SAMPLES) / SAMPLES)

    def rates(now, z):
        error = amplitude * np.cos(omega * now) - 0.3 * z[0]
        beyond = error - np.clip(error, -TRUTH["dead"], TRUTH["dead"])
        force = np.clip(beyond, -TRUTH["limit"], TRUTH["limit"])
        return (z[1], GAIN * force - TRUTH["d"] * z[1] - TRUTH["w"] * z[0])

    # Steps so short that no kink is passed unseen.
    solution = solve_ivp(
        rates, (0, end), (0, 0), t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.05 / omega
    )
    return 2 * np.mean(solution.y[0] * np.exp(-1j * omega * t)) / amplitude


def problem(model: gb.StateSpace, responses: list[np.ndarray], *, linear: bool) -> gb.Problem:
    """Return the problem of both tests, with errors that are the same for both models."""
    random = np.random.default_rng(0)
    parts = []
    for amplitude, exact in zip(AMPLITUDES, responses, strict=True):
        error = NOISE * (random.normal(size=OMEGA.size) + 1j * random.normal(size=OMEGA.size))
        name = f"amplitude {amplitude}"
        data = gb.FrequencyResponse(OMEGA, exact * (1 + error), input="u", output="x", name=name)
        options: Any = {} if linear else {"amplitude": {"u": amplitude}}
        parts.append(gb.Problem(model, data, **options))
    return sum(parts[1:], parts[0])


def timed(stated: gb.Problem) -> tuple[float, gb.Fit]:
    """Return processor seconds and the fit."""
    began = time.process_time()
    fit = gb.fit(stated, starts=2, seed=0, progress=False)
    return time.process_time() - began, fit


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs

    exact = [np.array([simulated(omega, a) for omega in OMEGA]) for a in AMPLITUDES]
    values = {**TRUTH, "dead": 0.0, "limit": 1e3}
    lag = {name: values[name] for name in ("d", "w")}
    linear_response = gb.frequency_response(LinearServo(), lag, OMEGA).response
    linear = problem(LinearServo(), [linear_response] * len(AMPLITUDES), linear=True)
    switched = problem(Servo(), exact, linear=False)

    timed(linear)  # imports
    pairs = [(timed(linear)[0], *timed(switched)) for _ in range(runs)]
    fit = pairs[0][-1]
    ratios = [seconds / short for short, seconds, _ in pairs]
    print(f"linear fit   {np.median([pair[0] for pair in pairs]):.3f} s")
    print(f"balance      {np.median([pair[1] for pair in pairs]):.2f} s")
    print(f"ratio        {np.median(ratios):.0f} ({min(ratios):.0f} to {max(ratios):.0f})")
    parts: Any = fit.parts
    for part, wanted in zip(parts, exact, strict=True):
        response = gb.modeling.harmonic_response(
            Servo(), TRUTH, OMEGA, amplitude=part.sine
        ).response
        print(
            f"{part.name}: {part.sine.harmonics} harmonics, at the true values at most "
            f"{100 * np.abs(response / wanted - 1).max():.2g} % from the simulation"
        )
    for name, value in TRUTH.items():
        estimate, error = fit.estimate[name], fit.standard_error[name]
        print(
            f"{name:6s} {estimate:9.5f} ± {error:.5f}, truth {value:g}: "
            f"{(estimate - value) / error:+.2f} standard errors"
        )


if __name__ == "__main__":
    main()
