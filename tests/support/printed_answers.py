"""Printed answers of representative fits.

``python tests/support/printed_answers.py`` renews tests/golden/answers.txt.
"""

import math
import re
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.assessment.verdict import verdict
from greybox.problems import pitch_hover

GOLDEN = Path(__file__).parents[1] / "golden" / "answers.txt"
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


class Lag(gb.StateSpace):
    """A lag with a gain: x' = (K u - x) / T."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    K = gb.Parameter(1.0, bounds=(0.0, 10.0), about="gain")
    T = gb.Parameter(1.0, bounds=(0.01, 5.0), unit="s", about="time constant")

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.x) / p.T,)

    def output(self, x, u, p):
        return (x.x,)


class Line(gb.StateSpace):
    """A straight line without dynamics."""

    states, inputs, outputs = (), ("u",), ("y",)
    slope = gb.Parameter(1.0, bounds=(-10, 10))
    offset = gb.Parameter(0.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.slope * u.u + p.offset,)


class Product(Line):
    """A line of which only a product of two factors is determined."""

    factor = gb.Parameter(1.0, bounds=(0.1, 10))

    def output(self, x, u, p):
        return (p.slope * p.factor * u.u + p.offset,)


def record(seed, samples=200, **known):
    """Return a noisy response of the lag to a staircase of random steps."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.normal(size=samples // 10), 10)
    flight = gb.Record(0.05 * np.arange(samples), {"u": u}, **known)
    x = gb.simulate(Lag(), {"K": 2.0, "T": 0.4}, flight, inputs="held")["x"]
    return flight.with_signals({"x": "rad"}, x=x + 0.05 * random.normal(size=samples))


def response(seed):
    """Return a noisy frequency response of the lag."""
    random = np.random.default_rng(seed)
    omega = np.geomspace(0.3, 30, 15)
    noise = 1 + 0.03 * (random.normal(size=15) + 1j * random.normal(size=15))
    exact = gb.frequency_response(Lag(), {"K": 2.0, "T": 0.4}, omega).response
    return gb.FrequencyResponse(omega, exact * noise, "u", "x", name="sines")


def rows():
    """Return rows without a time on a straight line."""
    random = np.random.default_rng(4)
    u = random.normal(size=40)
    y = 2 * u + 1 + 0.1 * random.normal(size=40)
    return gb.Record(np.arange(40.0), {"u": u, "y": y}, name="rows", has_time=False)


def fit(problem, starts=2, **options):
    return gb.fit(problem, starts=starts, progress=False, **options)


def answers():
    """Yield the titles of the answers and their texts."""
    held = gb.OutputError(inputs="held")
    of_response = fit(pitch_hover.problem(), 8)
    yield "a response", of_response
    yield "identifiability of a response", of_response.identifiability
    yield "verdict on a response", "\n".join(verdict(of_response).sentences)
    yield "a response from the default starts", gb.fit(gb.Problem(Lag(), response(1)))
    yield "a failed fit", fit(pitch_hover.problem(), solver_options={"max_iter": 1})

    flight = record(2, name="flight", hold={"u": math.inf})
    of_record = fit(gb.Problem(Lag(), flight))
    yield "a record", of_record
    yield "a prediction", gb.predict(of_record)
    yield "a record that does not know how its input runs", fit(gb.Problem(Lag(), record(2)))
    joint = gb.Problem(Lag(), flight) + gb.Problem(Lag(), response(1))
    yield "a record and a response", fit(joint)
    prior = gb.Problem(Lag(), flight, held, prior={"T": (0.4, 0.01)})
    yield "a record with a prior", fit(prior)
    many = [record(10 + k, 60) for k in range(11)]
    biased = gb.OutputError(inputs="held", biases=("x",))
    yield "eleven records with biases", fit(gb.several(Lag(), many, criterion=biased), 1)
    yield "profiles of a record", gb.profile(of_record)

    fixed = fit(gb.Problem(Lag(), flight, fixed={"T": 0.3}))
    yield "a comparison", gb.compare(fixed, of_record)
    manoeuvre = gb.spectral.transient_spectrum(flight, "u", "x", (0.5, 8.0))
    yield "a manoeuvre", fit(gb.Problem(Lag(), manoeuvre))
    yield "rows without a time", fit(gb.Problem(Line(), rows()))
    yield "parameters that are not determined", fit(gb.Problem(Product(), rows()))


def printed():
    """Return all answers as one text, without the times that they took."""
    pieces = [f"==== {title} ====\n{answer}\n" for title, answer in answers()]
    text = "\n".join(line.rstrip() for line in "\n".join(pieces).splitlines())
    return re.sub(r"^  [\d.]+ s; starts", "  (time) s; starts", text, flags=re.M) + "\n"


def differences(expected, actual):
    """Yield the lines of two texts that differ in words, or in numbers beyond rounding.

    Numbers may differ by a thousandth, and by one in the last digit that is printed.
    """
    before, after = expected.splitlines(), actual.splitlines()
    if len(before) != len(after):
        yield f"{len(after)} lines instead of {len(before)}"
    for one, other in zip(before, after, strict=False):
        words = [re.sub(r"[\s-]+", " ", NUMBER.sub("#", line)) for line in (one, other)]
        numbers = [NUMBER.findall(line) for line in (one, other)]
        if words[0] != words[1] or not all(map(_close, *numbers)):
            yield f"- {one}\n+ {other}"


def _close(one, other):
    unit = 10.0 ** -len(one.partition("e")[0].partition(".")[2])
    unit *= 10.0 ** int(one.partition("e")[2] or 0)
    # Probabilities far below any level of significance differ by factors.
    return abs(float(one) - float(other)) <= 1e-3 * abs(float(one)) + max(1.01 * unit, 1e-9)


if __name__ == "__main__":
    GOLDEN.parent.mkdir(exist_ok=True)
    GOLDEN.write_text(printed(), encoding="utf-8")
