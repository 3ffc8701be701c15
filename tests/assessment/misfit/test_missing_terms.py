"""A term that a model with many states lacks is found in its equation, among terms of its kind."""

import re

import numpy as np
import pytest
from scipy.signal import lfilter

import greybox as gb
from greybox.assessment.verdict import verdict

CELLS = 11
TIME = 0.2 * np.arange(150)  # s


class Chain(gb.StateSpace):
    """A heated chain of cells that lose heat to their surroundings."""

    states = tuple(f"T{i}" for i in range(CELLS))
    inputs, outputs = ("u",), ("T0", "T3", "T10")
    a = gb.Parameter(1.0, bounds=(0.1, 10), unit="1/s")
    h = gb.Parameter(0.5, bounds=(0.01, 5), unit="1/s")
    b = gb.Parameter(5.0, bounds=(0.1, 50), unit="1/s")
    radiation = 0.0

    def derivative(self, x, u, p):
        T = [getattr(x, name) for name in self.states]
        flows = [p.b * u.u, *(p.a * (T[i] - T[i + 1]) for i in range(CELLS - 1)), 0.0]
        rates = [flows[i] - flows[i + 1] - p.h * T[i] for i in range(CELLS)]
        rates[0] = rates[0] - self.radiation * T[0] ** 3
        return tuple(rates)

    def output(self, x, u, p):
        return (x.T0, x.T3, x.T10)


class Radiating(Chain):
    radiation = 0.3


def test_the_missing_term_is_named_with_its_equation():
    u = np.sign(np.sin(0.7 * TIME) + 0.3 * np.sin(2.1 * TIME)) + 0.3
    still = dict.fromkeys(Chain.states, 0.0)
    driven = gb.Record(TIME, {"u": u}, hold={"u": np.inf})
    truth = {"a": 2.0, "h": 0.3, "b": 4.0}
    motion = gb.simulate(Radiating(), truth, driven, initial=still)
    noise = 0.01 * np.random.default_rng(0).normal(size=(3, TIME.size))
    measured = {name: motion[name] + e for name, e in zip(Chain.outputs, noise, strict=True)}
    record = gb.Record(TIME, {"u": u, **measured}, hold={"u": np.inf})
    fit = gb.fit(
        gb.Problem(Chain(), record, gb.OutputError(initial=still)), starts=1, profiles=False
    )
    assert not fit.misfit.explains
    named = [cause.text for cause in fit.misfit.causes[:2]]
    assert any("T0**3 in the equation of T0" in text for text in named)


class Lag(gb.StateSpace):
    """v' = b u - d v."""

    states, inputs, outputs = ("v",), ("u",), ("v",)
    d = gb.Parameter(2.0, bounds=(0.1, 20))
    b = gb.Parameter(3.0, bounds=(0.1, 20))

    def derivative(self, x, u, p):
        return (p.b * u.u - p.d * x.v,)

    def output(self, x, u, p):
        return (x.v,)


def lagging(acting, seed=0, n=600, sensor=lambda v: v, **signals):
    """Fit the lag with the input `u` to a record of a lag that `acting` drives."""
    decay = np.exp(-0.1)
    v = sensor(lfilter([0, 1.5 * (1 - decay)], [1, -decay], acting))
    v = v + 0.01 * np.random.default_rng(seed).normal(size=n)
    record = gb.Record(0.05 * np.arange(n), {"v": v, **signals}, hold={"u": np.inf})
    return gb.fit(gb.Problem(Lag(), record), starts=1, progress=False, profiles=False).misfit


def test_what_white_noise_leaves_is_that_of_samples_and_not_of_their_means():
    u = np.repeat(np.random.default_rng(1).uniform(-1, 1, 150), 10)
    misfit = lagging(
        u, n=1500, sensor=lambda v: v + np.random.default_rng(2).normal(size=1500), u=u
    )
    assert misfit.explains
    # The noise has a variance of 1, and the signal one of 0.25.
    assert 0.75 < misfit.noise < misfit.left < 0.85


def test_an_input_that_an_actuator_quantizes_is_named():
    u = np.repeat(np.random.default_rng(1).uniform(-1, 1, 60), 10)
    misfit = lagging(np.round(u / 0.15) * 0.15, u=u)
    assert not misfit.explains
    assert misfit.likely[0].text == "an input u with a curved characteristic"
    assert lagging(u, u=u).explains


STEPS = np.repeat(np.random.default_rng(7).uniform(-1, 1, 60), 10)


@pytest.mark.parametrize("sample", [598, 599])
def test_an_outlier_at_the_end_is_no_missing_term(sample):
    """A jump before the last samples would look like a term, which no other sample could doubt."""
    outlier = 0.5 * (np.arange(600) == sample)
    assert lagging(STEPS, sensor=lambda v: v + outlier, u=STEPS).explains


IS_LATE = np.arange(600) > 340  # from 17 s on


@pytest.mark.parametrize(
    ("acting", "sensor", "text"),
    [
        (STEPS + 0.3 * IS_LATE, lambda v: v, r"a constant 0\.\d+ in the equation of v from 1[678]"),
        (STEPS, lambda v: v + 0.1 * IS_LATE, r"an offset of v by 0\.\d+ from 1[678]"),
    ],
    ids=["load", "offset"],
)
def test_what_acts_on_a_part_of_the_record_is_named(acting, sensor, text):
    misfit = lagging(acting, sensor=sensor, u=STEPS)
    assert not misfit.explains
    assert re.match(text, misfit.likely[0].text)


class Tank(gb.StateSpace):
    """A tank with an outlet: h' = b u - c sqrt(h)."""

    states, inputs, outputs = ("h",), ("u",), ("h",)
    b = gb.Parameter(0.3, bounds=(0, 6))
    c = gb.Parameter(0.25, bounds=(0, 5))

    def derivative(self, x, u, p):
        return (p.b * u.u - p.c * gb.sqrt(gb.maximum(x.h, 0.01)),)

    def output(self, x, u, p):
        return (x.h,)


def test_a_load_that_biases_the_values_until_residuals_look_like_drift_is_not_called_good():
    random, time = np.random.default_rng(2), 0.25 * np.arange(480)
    waves = [np.sin(w * time + random.uniform(0, 6)) for w in (0.03, 0.1, 0.3, 0.7)]
    u, h = 1.2 + 0.25 * sum(waves), [2.0]
    for inflow in 0.3 * u + 0.08 * (time > 66):
        level = h[-1]
        for _ in range(5):  # Euler steps of 50 ms
            level += 0.05 * (inflow - 0.25 * np.sqrt(max(level, 0.01)))
        h.append(level)
    h = np.array(h[:-1])
    measured = h + 0.05 * np.std(h) * random.normal(size=480)
    record = gb.Record(time, {"u": u, "h": measured}, hold={"u": np.inf})
    fit = gb.fit(gb.Problem(Tank(), record), starts=2, progress=False, profiles=False)
    assert fit.misfit.is_drifting
    assert verdict(fit).grade == "doubt"


def test_a_mode_of_the_input_is_named_whatever_its_phase():
    random = np.random.default_rng(2)
    u = np.repeat(random.choice([-1.0, 1.0], 60), 10)
    for phase in (0.0, np.pi / 2):
        after = 0.03 * np.exp(-0.02 * np.arange(400)) * np.cos(0.2 * np.arange(400) + phase)
        misfit = lagging(u + np.convolve(u, after)[: u.size], u=u)
        assert not misfit.explains
        assert re.match(r"a lightly damped mode of u near (3.[5-9]|4.*)", misfit.likely[0].text)


def test_a_mode_of_few_periods_is_a_drift_at_best():
    u = np.repeat(np.random.default_rng(1).uniform(-1, 1, 60), 10)
    w = 2 * np.tan(np.pi * 2.5 / u.size)  # a phugoid of 2.5 periods with a damping of 0.1
    poles = [4 + w * (0.4 + w), 2 * w**2 - 8, 4 + w * (w - 0.4)]
    misfit = lagging(u - 0.3 * lfilter([w**2, 2 * w**2, w**2], poles, u), u=u)
    assert misfit.is_drifting


def test_a_clock_that_is_early_is_named():
    u = np.repeat(np.random.default_rng(1).uniform(-1, 1, 66), 10)
    misfit = lagging(u[36:636], u=u[30:630])
    # The fit takes a part of six samples of 50 ms by a faster pole.
    assert re.fullmatch(r"a lead of u by 0\.[123]\d* s", misfit.likely[0].text)


def test_a_logged_input_that_the_model_lacks_is_named_but_not_a_second_sensor():
    random = np.random.default_rng(3)
    u, second, gust = (np.repeat(random.uniform(-1, 1, 60), 10) for _ in range(3))
    misfit = lagging(u + 0.1 * second, u=u, w=second)
    assert misfit.likely[0].text == "w in the equation of v"
    assert "u.w" in misfit.likely[0].code
    moved = u + 0.3 * gust
    sensor = lfilter([0, 1.5 * (1 - np.exp(-0.1))], [1, -np.exp(-0.1)], moved)
    assert not any("w in" in cause.text for cause in lagging(moved, u=u, w=sensor).likely)


@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_a_dead_zone_has_its_name_in_any_unit_of_the_time(unit):
    t = 0.05 * np.arange(480)
    u = np.sin(1.3 * t) + 0.5 * np.sin(3.1 * t)
    moved = u - np.clip(u, -0.3, 0.3)
    v = lfilter([0, 1.5 * (1 - np.exp(-0.1))], [1, -np.exp(-0.1)], moved)
    v += 0.01 * np.random.default_rng(5).normal(size=t.size)
    record = gb.Record(unit * t, {"u": u, "v": v}, hold={"u": np.inf})

    class Fast(Lag):
        d = gb.Parameter(2.0 / unit, bounds=(0.1 / unit, 20 / unit))
        b = gb.Parameter(3.0 / unit, bounds=(0.1 / unit, 20 / unit))

    misfit = gb.fit(gb.Problem(Fast(), record), starts=1, profiles=False).misfit
    assert misfit.causes[0].text.startswith("a dead zone of u near")


def behind_a_rate_limit(position, command):
    return position + np.clip(command - position, -0.08, 0.08)


def behind_a_play(position, command):
    return np.clip(position, command - 0.15, command + 0.15)


def causes(actuator, trim=0.0):
    """Of a lag behind an actuator that the model lacks."""
    step = 0.05
    t = step * np.arange(480)
    u = trim + np.sin(1.3 * t) + 0.5 * np.sin(3.1 * t)
    position, v, measured = trim, 1.5 * trim, []
    for command in u:
        measured.append(v)
        position = actuator(position, command)
        v = np.exp(-2 * step) * v + 1.5 * (1 - np.exp(-2 * step)) * position
    measured += 0.01 * np.random.default_rng(5).normal(size=t.size)
    record = gb.Record(t, {"u": u, "v": measured}, hold={"u": np.inf})
    fit = gb.fit(gb.Problem(Lag(), record), starts=1, profiles=False)
    assert not fit.misfit.explains
    return [cause.text for cause in fit.misfit.causes]


@pytest.mark.parametrize(
    ("actuator", "text"),
    [(behind_a_rate_limit, "a rate limit of u near"), (behind_a_play, "a backlash of u of about")],
)
def test_an_actuator_that_follows_late_is_named(actuator, text):
    assert causes(actuator)[0].startswith(text)


@pytest.mark.parametrize(("side", "limit"), [(np.minimum, 2.6), (np.maximum, 1.4)])
def test_a_limit_on_one_side_of_a_trim_is_named_with_its_value(side, limit):
    cause = causes(lambda _, command: side(command, limit), trim=2.0)[0]
    level = re.fullmatch(r"a gain of u that is smaller beyond ([\d.]+), as .* one side", cause)[1]
    assert float(level) == pytest.approx(limit, abs=0.1)


class Basin(gb.StateSpace):
    """The level of a basin, from its middle."""

    states, inputs, outputs = ("h",), ("u",), ("h",)
    b = gb.Parameter(1.0, bounds=(0.1, 10))
    c = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return (p.b * u.u - p.c * x.h,)

    def output(self, x, u, p):
        return (x.h,)


@pytest.mark.parametrize(("bound", "level"), [(gb.maximum, 0.5), (gb.minimum, -0.5)])
def test_a_stop_that_a_seventh_of_the_samples_reach_is_named_with_its_level(bound, level):
    class Stopped(Basin):
        def derivative(self, x, u, p):
            (speed,) = super().derivative(x, u, p)
            return (speed - 20 * bound(x.h - level, 0.0),)

    random = np.random.default_rng(0)
    u = np.repeat(random.uniform(-1, 1, 30), 20)
    flight = gb.Record(0.1 * np.arange(u.size), {"u": u}, hold={"u": np.inf})
    h = gb.simulate(Stopped(), {"b": 1.0, "c": 1.0}, flight)["h"]
    flight = flight.with_signals(h=h + 0.01 * random.normal(size=h.size))
    fit = gb.fit(gb.Problem(Basin(), flight), starts=[{}], progress=False, profiles=False)
    cause = fit.misfit.likely[0].text
    near = re.fullmatch(r"a stop or an overflow of h near (\S+) in the equation of h", cause)[1]
    assert float(near) == pytest.approx(level, abs=0.03)
