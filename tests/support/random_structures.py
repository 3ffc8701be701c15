"""Random models whose redundancies are known: what is planted, and what may be said of it."""

from dataclasses import dataclass

import numpy as np

import greybox as gb

OMEGA = np.geomspace(0.3, 30, 25)
KINDS = ("product", "ratio", "square", "sum", "three", "dead", "bias")


@dataclass(frozen=True)
class Planted:
    """A problem with simulated data, the parameters planted as not determined, and the combination
    that is."""

    problem: gb.Problem
    lost: frozenset
    powers: frozenset | None = None  # (name, power) of the combination, up to its sign
    value: float = np.nan


def planted(kind: str, seed: int) -> Planted:
    """Return a random structure with one redundancy of this kind, and no other."""
    random = np.random.default_rng(seed)
    if kind == "bias":
        return _confounded_biases(random)
    truth = {
        "w": random.uniform(2, 8),
        "z": random.uniform(0.2, 0.7),
        "T": random.uniform(0.05, 0.5),
    }
    k, m, n = random.uniform(0.5, 5, 3)
    gain, powers = {
        "product": (lambda p: p.k * p.m, {"k": 1, "m": 1}),
        "ratio": (lambda p: p.k / p.m, {"k": 1, "m": -1}),
        "square": (lambda p: p.k * p.m**2, {"k": 1, "m": 2}),
        "sum": (lambda p: p.k + p.m, {"k": 1, "m": 1}),
        "three": (lambda p: p.k * p.m / p.n, {"k": 1, "m": 1, "n": -1}),
        "dead": (lambda p: p.k, {}),
        "clean": (lambda p: p.k, {}),
    }[kind]
    extra = {"k": k}
    if kind != "clean":
        extra["m"] = m
    if kind == "three":
        extra["n"] = n
    has_zero = random.random() < 0.5
    parameters = {**truth, **extra}
    # The order of declaration must not matter.
    order = [str(name) for name in random.permutation(list(parameters))]
    declared = {
        name: gb.Parameter(value, bounds=(0.001, 100), starts=(value / 2, 2 * value))
        for name, value in ((name, float(parameters[name])) for name in order)
    }

    class Random(gb.TransferFunction):
        """A second-order lag with a first-order lag or lead."""

        input, output = "u", "y"

        def response(self, s, p):
            lag = gain(p) * p.w**2 / (s**2 + 2 * p.z * p.w * s + p.w**2)
            return lag * (p.T * s + 1) if has_zero else lag / (p.T * s + 1)

    model = type("Random", (Random,), {"__doc__": Random.__doc__, **declared})()
    exact = gb.frequency_response(model, parameters, OMEGA).response
    errors = random.normal(size=(2, OMEGA.size)) * 0.02 / np.sqrt(2)
    data = gb.FrequencyResponse(
        OMEGA, exact * (1 + errors[0] + 1j * errors[1]), input="u", output="y"
    )
    value = float(gain(type("P", (), parameters)))
    if kind == "dead":
        return Planted(gb.Problem(model, data, gb.SquaredRelativeError()), frozenset({"m"}))
    return Planted(
        gb.Problem(model, data, gb.SquaredRelativeError()),
        frozenset(powers),
        frozenset(powers.items()),
        value,
    )


class Offsets(gb.StateSpace):
    """A straight line whose two offsets are seen as their sum alone."""

    states, inputs, outputs = (), ("u",), ("y",)
    b1 = gb.Parameter(0.0, bounds=(-10, 10))
    slope = gb.Parameter(1.0, bounds=(-10, 10))
    b2 = gb.Parameter(0.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.b1 + p.b2 + p.slope * u.u,)


def _confounded_biases(random: np.random.Generator) -> Planted:
    """Return a line whose offset is the sum of two parameters."""
    u = np.linspace(-1, 1, 80)
    first, slope, second = random.uniform(0.5, 2, 3)
    y = first + second + slope * u + 0.02 * random.normal(size=u.size)
    data = gb.Record(None, {"u": u, "y": y})
    powers = frozenset({("b1", 1), ("b2", 1)})
    return Planted(gb.Problem(Offsets(), data), frozenset({"b1", "b2"}), powers, first + second)


def named_rightly(fit: gb.Fit, truth: Planted) -> str:
    """Return what is wrong with what a fit says of a planted redundancy; empty where nothing is."""
    lost = {name for name in fit.free if np.isnan(fit.standard_error[name])}
    if lost != truth.lost:
        return f"{sorted(lost)} have no standard error, planted were {sorted(truth.lost)}"
    if not all(any(name in text for text in fit.warnings) for name in lost):
        return "a warning is missing"
    found = fit.identifiability.combinations
    if len(found) != (truth.powers is not None):
        return f"{len(found)} combinations: {'; '.join(map(str, found))}"
    for one in found:
        powers = frozenset(zip(one.names, one.powers, strict=True))
        value = truth.value if truth.powers == powers else 1 / truth.value
        turned = frozenset((name, -power) for name, power in powers)
        if truth.powers not in (powers, turned) or abs(one.value - value) > 5 * one.standard_error:
            return f"{one} was found, the truth is {value:.5g}"
    return ""
