"""Whether a fit says when its model is wrong, and what it lacks.

``python benchmarks/misfit.py [draws] [seed]``: six plants (the last one unstable, in a closed
loop) are simulated by a Runge-Kutta loop of their own, with fourteen defects, and fitted by models
without them; three responses with six defects; and the Fourier integrals of flights of four linear
plants with five defects. The table counts the wrong models that are recognized, among those whose
misfit exceeds the noise, how often the right cause is among the first two, the right models that
are called wrong in white, colored and drifting noise, and the time over that of the fit alone.
Records last 10 to 300 s, of plants with time constants of 0.3 to 1 s; the noise is 0.5 to 10 % of
the signal. Errors of right responses are independent, correlated along frequency, or ten times
larger at the highest frequencies. Fits have two starts, which saves time, but of which the test is
a larger share than of the default ones: six fits with these show the share that a user meets. One
draw takes two minutes.
"""

# ruff: noqa: D102  (formulas of models)

import sys
import time

import numpy as np

import greybox as gb
import greybox.assessment.assess

ASSESS = sys.modules["greybox.assessment.assess"]
LENGTHS, STEP = (330, 1000, 600, 3300, 10000), 0.03  # samples, s
BOUNDS = (0.0, 500.0)


class Spring(gb.StateSpace):
    """x'' = b u - k x - d x'."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    k, d, b = (gb.Parameter(v, bounds=BOUNDS) for v in (25.0, 2.0, 25.0))

    def derivative(self, x, u, p):
        return x.v, p.b * u.u - p.k * x.x - p.d * x.v

    def output(self, x, u, p):
        return (x.x,)


class Lag(gb.StateSpace):
    """v' = b u - d v."""

    states, inputs, outputs = ("v",), ("u",), ("v",)
    d, b = gb.Parameter(2.0, bounds=BOUNDS), gb.Parameter(3.0, bounds=BOUNDS)

    def derivative(self, x, u, p):
        return (p.b * u.u - p.d * x.v,)

    def output(self, x, u, p):
        return (x.v,)


class Servo(gb.StateSpace):
    """A spring behind an actuator."""

    states, inputs, outputs = ("a", "x", "v"), ("u",), ("x",)
    T = gb.Parameter(0.1, bounds=(0.01, 2))
    k, d, b = (gb.Parameter(v, bounds=BOUNDS) for v in (9.0, 2.0, 9.0))

    def derivative(self, x, u, p):
        return (u.u - x.a) / p.T, x.v, p.b * x.a - p.k * x.x - p.d * x.v

    def output(self, x, u, p):
        return (x.x,)


class Speed(gb.StateSpace):
    """v' = b u - c |v| v."""

    states, inputs, outputs = ("v",), ("u",), ("v",)
    c, b = gb.Parameter(1.0, bounds=BOUNDS), gb.Parameter(3.0, bounds=BOUNDS)

    def derivative(self, x, u, p):
        return (p.b * u.u - p.c * abs(x.v) * x.v,)

    def output(self, x, u, p):
        return (x.v,)


class Rate(Spring):
    """The spring, angle and rate measured."""

    outputs = ("x", "v")

    def output(self, x, u, p):
        return (x.x, x.v)


class Pendulum(Rate):
    """x'' = b u + k x - d x', stabilized by a controller."""

    k, d, b = (gb.Parameter(v, bounds=BOUNDS) for v in (5.0, 1.0, 20.0))

    def derivative(self, x, u, p):
        return x.v, p.b * u.u + p.k * x.x - p.d * x.v


PLANTS = (Spring, Lag, Servo, Speed, Rate, Pendulum)

# Words of the right cause; a late sensor cannot be told from a late input.
DEFECTS = {
    "delay": ("delay of u", "late"),
    "lag": ("lag of u",),
    "zero": ("lead of u", "direct effect"),
    "saturation": ("saturation",),
    "dead zone": ("dead zone",),
    "rate limit": ("rate limit",),
    "backlash": ("backlash",),
    "cubic": ("**3",),
    "friction": ("sign(",),
    "drag": ("abs(",),
    "product": ("v * u", "x * u"),
    "clock": ("delay of u", "late"),
    "early": ("lead of u", "early"),
    "drift": ("changes along",),
}


def excitation(kind, samples, random):
    """Return a test signal (n,)."""
    t = STEP * np.arange(samples)
    if kind == "steps":
        return np.repeat(random.uniform(-1, 1, samples // 30 + 1), 30)[:samples]
    if kind == "sines":
        omega = (0.7, 1.3, 2.1, 3.7, 5.9, 8.3)
        return sum(np.sin(w * t + random.uniform(0, 6)) for w in omega) / 2.5
    return np.sin(0.5 * (np.exp(3.2 * t / t[-1]) - 1) * t[-1] / 3.2)


def flown(plant, defect, kind, e, random):
    """Return input (n,) and outputs (k, n) of a plant with a defect, by Runge-Kutta steps.

    The controller of a pendulum acts on outputs with the noise `e` (k, n).
    """
    samples = e.shape[1]
    model = plant()
    value = {name: p.start for name, p in model.parameters.items()}
    names = gb.modeling.model.Names
    command, past = excitation(kind, samples, random), [0.0] * 8
    x = np.zeros(len(model.states))
    u, y, lagged, moved = np.zeros(samples), [], 0.0, 0.0
    main = model.states[-2] if len(model.states) > 1 else "v"

    def derivative(state, acting, share):
        p = names(value | ({"b": value["b"] * (1 + share)} if defect == "drift" else {}))
        now = names(dict(zip(model.states, state, strict=True)))
        slope = np.array(model.derivative(now, names({"u": acting}), p), dtype=float)
        terms = {
            "cubic": -0.8 * value["b"] * now[main] ** 3,
            "friction": -0.2 * value["b"] * np.tanh(now.v / 0.01),
            "drag": -(0.06 if main == "x" else 1.0) * value["b"] * abs(now.v) * now.v,
            "product": 0.5 * value["b"] * acting * now[main],
        }
        slope[-1] += terms.get(defect, 0.0)
        return slope

    substeps = 10 if defect == "friction" else 2
    for i in range(samples):
        u[i] = command[i]
        if plant is Pendulum:
            # Sensors have the noise that the record shows, which the controller answers at once.
            u[i] = 0.6 * command[i] - 1.2 * (x[0] + e[0, i]) - 0.25 * (x[1] + e[1, i])
        past.append(u[i])
        y.append(
            x if len(model.outputs) == len(x) else x[model.states.index(model.outputs[0]), None]
        )
        level = 0.4 * np.abs(command).max()
        if defect == "rate limit":
            moved += np.clip(u[i] - moved, -4 * level * STEP, 4 * level * STEP)
        elif defect == "backlash":
            moved = np.clip(moved, u[i] - level / 3, u[i] + level / 3)
        late = past[-1 - (3 if plant is Pendulum else 5)]
        acting = {
            "delay": late,
            "saturation": np.clip(u[i], -level, level),
            "dead zone": u[i] - np.clip(u[i], -level / 2, level / 2),
            "lag": lagged,
            "rate limit": moved,
            "backlash": moved,
            "zero": u[i] + (0.1 * (u[i] - past[-2]) / STEP),
        }.get(defect, u[i])
        lagged += (u[i] - lagged) * (1 - np.exp(-STEP / 0.12))
        h = STEP / substeps
        for _ in range(substeps):
            share = 0.8 * (i / samples - 0.5)
            k1 = derivative(x, acting, share)
            k2 = derivative(x + h / 2 * k1, acting, share)
            k3 = derivative(x + h / 2 * k2, acting, share)
            k4 = derivative(x + h * k3, acting, share)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    y = np.array(y).T
    shift = {"clock": 4, "early": -4}.get(defect, 0)
    return u, np.roll(y, shift, axis=1)[:, 4:-4] if shift else y[:, 4:-4]


def noise(color, size, random):
    """Return noise (n,) of unit variance, or with a random walk of that size beside it."""
    e = random.normal(size=size)
    if color == "colored":
        for i in range(1, size):
            e[i] = 0.9 * e[i - 1] + np.sqrt(1 - 0.9**2) * e[i]
    if color == "drifting":
        e += 0.1 * np.cumsum(random.normal(size=size))
    return e


def recorded(plant, defect, color, kind, seed):
    """Return the record of a flight, and its noise (k, n)."""
    random = np.random.default_rng(seed)
    samples = LENGTHS[seed % len(LENGTHS)]
    e = np.zeros((len(plant.outputs), samples))
    _, quiet = flown(plant, defect, kind, e, np.random.default_rng(seed))
    size = quiet.std(axis=1) * random.choice([0.005, 0.02, 0.05, 0.1])
    e = size[:, None] * np.array([noise(color, samples, random) for _ in e])
    u, y = flown(plant, defect, kind, e, np.random.default_rng(seed))
    e, u = e[:, 4:-4], u[4:-4]
    signals = dict(zip(plant.outputs, y + e, strict=True))
    return gb.Record(STEP * np.arange(u.size), {"u": u} | signals, hold={"u": np.inf}), e


def fitted(plant, defect, color, kind, seed, starts=2):
    """Return the fit to a flight, with times, and the residuals over the noise."""
    record, e = recorded(plant, defect, color, kind, seed)
    fit = timed(gb.Problem(plant(), record), starts)
    errors = [fit[0].records[0].residual(name) for name in plant.outputs]
    # Misfit and noise together, over the noise.
    return fit, float(np.mean(np.square(errors).mean(axis=1) / np.square(e).mean(axis=1)))


def fitted_spectrum(plant, defect, color, draw, base):
    """Return the fit to the Fourier integrals of 10 or 18 s of a flight, at up to 30 lines."""
    seed = base + 5 * (draw // 2) + 2 * (draw % 2)  # the shorter lengths
    record, _ = recorded(plant, defect, color, ("steps", "sines", "sweep")[draw % 3], seed)
    spectrum = gb.spectral.transient_spectrum(record, "u", plant.outputs, (0.5, 10.0))
    return gb.fit(gb.Problem(plant(), spectrum), 2, progress=False)


def timed(problem, starts=2):
    """Return a fit, the time of its test of misfit, and that of the rest, s."""
    spent = []
    assessed = ASSESS.assessed_misfit

    def watched(*arguments):
        began = time.perf_counter()
        answer = assessed(*arguments)
        spent.append(time.perf_counter() - began)
        return answer

    ASSESS.assessed_misfit = watched
    began = time.perf_counter()
    try:
        fit = gb.fit(problem, starts, progress=False)
    finally:
        ASSESS.assessed_misfit = assessed
    return fit, sum(spent), time.perf_counter() - began - sum(spent)


class Resonance(gb.TransferFunction):
    """b / (s² + d s + k)."""

    input, output = "u", "y"
    k, d, b = (gb.Parameter(v, bounds=(v / 5, 5 * v)) for v in (25.0, 2.0, 25.0))

    def response(self, s, p):
        return p.b / (s**2 + p.d * s + p.k)


class First(gb.TransferFunction):
    """b / (s + d)."""

    input, output = "u", "y"
    d, b = (gb.Parameter(v, bounds=(v / 5, 5 * v)) for v in (3.0, 5.0))

    def response(self, s, p):
        return p.b / (s + p.d)


class Late(First):
    """The same with a delay."""

    T = gb.Parameter(0.03, bounds=(0, 0.2))

    def response(self, s, p):
        return super().response(s, p) * gb.exp(-s * p.T)


RESPONSES = {
    "pole": (lambda s: 1 / (1 + s / 12), ("pole",)),
    "zero": (lambda s: 1 + s / 12, ("zero", "lead")),
    "right zero": (lambda s: 1 - s / 12, ("zero", "delay")),
    "delay": (lambda s: np.exp(-0.05 * s), ("delay",)),
    "mode": (lambda s: 1 - 0.3 * s**2 / (s**2 + 0.66 * s + 121), ("mode",)),
    "step": (lambda s: np.where(s.imag > 6, 1.2, 1.0), ("gain that differs",)),
}


def measured(plant, defect, seed, correlation=0.0, last=1.0):
    """Return the fit to a response with errors of 1 to 6 %, and the times.

    Errors of the last sixth of the points are `last` times larger.
    """
    random = np.random.default_rng(seed)
    points = int(random.choice([10, 16, 24, 48]))
    s = 1j * np.geomspace(0.6, 30, points)
    size = random.choice([0.01, 0.03, 0.06])
    exact = gb.frequency_response(
        plant(), {n: p.start for n, p in plant.parameters.items()}, s.imag
    )
    errors = size * (random.normal(size=(points, 2)) @ [1, 1j]) / np.sqrt(2)
    for k in range(1, points):
        errors[k] = correlation * errors[k - 1] + np.sqrt(1 - correlation**2) * errors[k]
    errors[-(points // 6) :] *= last
    response = exact.response * defect(s) * (1 + errors)
    fit = timed(gb.Problem(plant(), gb.FrequencyResponse(s.imag, response, "u", "y")))
    return fit, float(np.mean(np.abs(fit[0].residuals[0] / response) ** 2) / size**2)


ERRORS = {
    "independent": {},
    "correlated": {"correlation": 0.8},
    "ten times larger last": {"last": 10.0},
}


def of_two(gain, seed):
    """Return the fit to two responses, the second with another gain."""
    random = np.random.default_rng(seed)
    s = 1j * np.geomspace(0.6, 30, 16)
    parts = []
    for factor in (1.0, gain):
        errors = 0.03 * (random.normal(size=(16, 2)) @ [1, 1j])
        response = factor * 25 / (s**2 + 2 * s + 25) * (1 + errors)
        data = gb.FrequencyResponse(s.imag, response, "u", "y")
        parts.append(gb.Problem(Resonance(), data, name=f"gain {factor}"))
    return gb.fit(parts[0] + parts[1], starts=2, progress=False)


def table(name, rows):
    """Print and add up rows of (exceeds the noise, called wrong, named among the first two)."""
    large = [row for row in rows if row[0]]
    called = sum(row[1] for row in large)
    named = sum(row[2] for row in large if row[1])
    print(
        f"  {name:<12} {len(large):3d} of {len(rows)} exceed the noise; called wrong {called}, "
        f"right cause among the first two {named}",
        flush=True,
    )
    return np.array([len(large), called, named])


def of_records(draws, base):
    """Print the tables of records, and return the times."""
    shares = []
    total = np.zeros(3, dtype=int)
    print("wrong models of records:")
    for defect, words in DEFECTS.items():
        rows = []
        for number, plant in enumerate(PLANTS):
            for draw in range(draws):
                kind = ("steps", "sines", "sweep")[(number + draw) % 3]
                seed = base + 100 * number + number + draw
                (fit, *times), ratio = fitted(plant, defect, "white", kind, seed)
                shares.append(times)
                rows.append((ratio > 2, *judged(fit, words)))
        total += table(defect, rows)
    print(f"records: {total[1]} of {total[0]} called wrong, {total[2]} of these by the right cause")

    wrong = {}
    for color in ("white", "colored", "drifting"):
        fits = [
            fitted(
                plant, "", color, ("steps", "sines", "sweep")[draw % 3], base + 1000 + 99 * n + draw
            )[0]
            for n, plant in enumerate(PLANTS)
            for draw in range(3 * draws)
        ]
        shares += [fit[1:] for fit in fits]
        wrong[color] = f"{sum(not fit.misfit.explains for fit, _, _ in fits)} of {len(fits)}"
    print(f"right models of records called wrong: {wrong}")

    return shares


def of_responses(draws, base):
    """Print the tables of responses."""
    total = np.zeros(3, dtype=int)
    print("wrong models of responses:")
    for name, (defect, words) in RESPONSES.items():
        rows = []
        for number, plant in enumerate((Resonance, First, Late)):
            if name == "delay" and plant is Late:
                continue
            for draw in range(2 * draws):
                (fit, _, _), ratio = measured(plant, defect, base + 100 * number + draw)
                rows.append((ratio > 2, *judged(fit, words)))
        total += table(name, rows)
    print(f"responses: {total[1]} of {total[0]} called wrong, {total[2]} by the right cause")
    for name, options in ERRORS.items():
        fits = [
            measured(plant, lambda s: 1.0, base + 500 + draw, **options)[0][0]
            for plant in (Resonance, First, Late)
            for draw in range(10 * draws)
        ]
        wrong = sum(not fit.misfit.explains for fit in fits)
        print(f"right models of responses called wrong, {name} errors: {wrong} of {len(fits)}")
    for gain, name in ((1.0, "equal"), (1.1, "of 10 % more gain")):
        fits = [of_two(gain, base + draw) for draw in range(10 * draws)]
        wrong = sum(not fit.misfit.explains for fit in fits)
        print(f"two responses called wrong, the second {name}: {wrong} of {len(fits)}")


def of_manoeuvres(draws, base):
    """Print the tables of Fourier integrals: linear plants and defects, in open loop."""
    plants = Spring, Lag, Servo, Rate
    print("wrong models of manoeuvres:")
    for name in ("delay", "lag", "zero", "clock", "early"):
        fits = [
            fitted_spectrum(plant, name, "white", draw, base)
            for plant in plants
            for draw in range(2 * draws)
        ]
        called = sum(not fit.misfit.explains for fit in fits)
        print(f"  {name:14s} {called} of {len(fits)} called wrong")
    for color in ("white", "colored", "drifting"):
        fits = [
            fitted_spectrum(plant, "", color, draw, base + 1000)
            for plant in plants
            for draw in range(6 * draws)
        ]
        wrong = sum(not fit.misfit.explains for fit in fits)
        print(f"right models of manoeuvres called wrong, {color} errors: {wrong} of {len(fits)}")


def main(draws=1, seed=0):
    """Print the tables; another seed gives other flights."""
    began = time.perf_counter()
    print(f"{draws} draws, seed {seed}")
    shares = of_records(draws, seed)
    of_responses(draws, seed)
    of_manoeuvres(draws, seed)
    usual = [fitted(plant, "", "white", "sweep", seed + 7, None)[0][1:] for plant in PLANTS]
    for words, times in (("two starts", shares), ("default starts, right models", usual)):
        percent = [100 * spent / rest for spent, rest in times]
        print(
            f"time of the test over that of the fit of a record, {words}: "
            f"{np.median(percent):.0f} % (median; {min(percent):.0f} to {max(percent):.0f} %)"
        )
    print(f"{time.perf_counter() - began:.0f} s")


def judged(fit, words):
    """Return whether the model is called wrong, with the right cause among the first two."""
    if fit.misfit is None:
        return False, False
    first = [cause.text for cause in fit.misfit.likely[:2]]
    return not fit.misfit.explains, any(word in text for word in words for text in first)


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:]))
