"""Gains against today's, held against hand-written loops and virtual flights of the true plant."""

import functools
import json
from importlib import import_module

import numpy as np
import pytest
from rate_control import RATE, RateDynamics, RateLoop, RateLoopWithD
from scipy.signal import cont2discrete, tf2ss

import greybox as gb
from greybox.models.firmware import flown_controllers, safe_gains_of_log
from greybox.problems import sitl_pitch

pytestmark = pytest.mark.usefixtures("few_draws", "unjudged_file")

DELAY = 2  # samples; the response contains half a sample more, that of the held control
TRUTH = {"K": 40.0, "a": 2.0, "T": 0.05, "tau": (DELAY + 0.5) / RATE}
TODAY = {"K_P": 0.15, "K_I": 0.3, "K_D": 0.012}
NARROW = {"K_P": (0.16, 0.18), "K_D": (0.0085, 0.012)}  # some sets are better than today's
ONE = {"K_P": (0.178, 0.2), "K_D": (0.00948, 0.012)}  # the first of which is hardly better
SENSITIVITY, MOMENT, NOISE = (
    "peak |S|",
    "peak q after a step moment at u",
    "noise from q to u",
)


@functools.cache
def fitted(seed=0, noise=0.03, gain=40.0, **options):
    omega = np.geomspace(0.5, 40.0, 40)
    exact = gb.frequency_response(RateDynamics(), TRUTH | {"K": gain}, omega)
    rng = np.random.default_rng(seed)
    errors = noise * (rng.normal(size=omega.size) + 1j * rng.normal(size=omega.size))
    variance = 2 * noise**2 * np.abs(exact.response) ** 2
    data = gb.FrequencyResponse(omega, exact.response * (1 + errors), "u", "q", variance=variance)
    # The delay is fixed, so that it is a whole number of samples.
    problem = gb.Problem(
        RateDynamics(), data, gb.MaximumLikelihood(), fixed={"tau": TRUTH["tau"]}, **options
    )
    return gb.fit(problem, starts=2, progress=False)


def plant_of(values):
    """The plant from one sample to the next, without its delay."""
    denominator = np.polymul([1, values["a"]], [values["T"], 1])
    return cont2discrete(tf2ss([values["K"]], denominator), 1 / RATE)


def simulated(values, gains, moment=0.0, impulse=0.0, samples=2500):
    """Rate and control of the loop, sample by sample, after a step of the control or noise once."""
    A, B, C, *_ = plant_of(values)
    x, integral, last, derivative = np.zeros(2), 0.0, 0.0, 0.0
    controls, rates = [0.0] * DELAY, []
    for k in range(samples):
        rate = float(C[0] @ x)
        error = -(rate + (impulse if k == 0 else 0.0))
        derivative += ((error - last) * RATE - derivative) / 3
        total = gains["K_P"] * error + gains["K_I"] * integral + gains["K_D"] * derivative
        integral, last = integral + error / RATE, error
        controls.append(total + moment)
        rates.append(rate)
        x = A @ x + B[:, 0] * controls[k]
    return np.array(rates), np.array(controls[DELAY:])


def sensitivity_peak(values, gains):
    """The largest |S| on a fine grid."""
    z = np.exp(1j * np.geomspace(0.05, np.pi * RATE, 40_000) / RATE)
    A, B, C, *_ = plant_of(values)
    plant = (C @ np.linalg.solve(z[:, None, None] * np.eye(2) - A, B.astype(complex)))[:, 0, 0]
    slope = RATE * (1 - 1 / z) / (3 - 2 / z)
    law = gains["K_P"] + gains["K_I"] / RATE / (z - 1) + gains["K_D"] * slope
    return np.abs(1 / (1 + law * plant * z**-DELAY)).max()


def by_hand(values, gains):
    """The three numbers, each by another way than the one under test."""
    return {
        SENSITIVITY: sensitivity_peak(values, gains),
        MOMENT: np.abs(simulated(values, gains, moment=1.0)[0]).max(),
        # The sum of the squared response to a single error is the variance from white noise.
        NOISE: np.sqrt(np.sum(simulated(values, gains, impulse=1.0)[1] ** 2)),
    }


@functools.cache
def narrow_answer():
    return gb.safe_gains(fitted(), RateLoopWithD(TODAY), NARROW)


@pytest.fixture
def one_set(few_draws, monkeypatch):
    """Try the first value of every range alone."""
    # By its path: `greybox.workflows.experiment.safe_gains` is the function.
    module = import_module("greybox.workflows.experiment.safe_gains")
    monkeypatch.setattr(module, "POINTS", {2: 1})


@pytest.fixture
def proposed():
    return narrow_answer()


@pytest.mark.parametrize(
    "today",
    [TODAY, {"K_P": 0.4, "K_I": 2.0, "K_D": 0.0}, {"K_P": 0.15, "K_I": 0.01, "K_D": 0.001}],
    ids=["much D", "hardly stable", "slow integral"],
)
def test_the_numbers_are_those_of_loops_written_by_hand(today):
    fit = fitted()
    names = [*TODAY][:2] if today["K_D"] == 0 else [*TODAY][::2]
    ranges = {name: (0.1 * today[name], 0.7 * today[name]) for name in names}
    requirements = {"phase_margin": 10, "gain_margin": 1}
    comparison = gb.safe_gains(fit, RateLoopWithD(today), ranges, **requirements).comparison
    if comparison is None:  # nothing is faster: look at what is
        ranges = {name: (1.1 * today[name], 2 * today[name]) for name in names}
        comparison = gb.safe_gains(fit, RateLoopWithD(today), ranges, **requirements).comparison
    before = by_hand(fit.estimate, today)
    after = by_hand(fit.estimate, today | comparison.gains)
    for name in (SENSITIVITY, MOMENT, NOISE):
        change = comparison[name]
        assert change.today == pytest.approx(before[name], rel=3e-5)
        assert change.changed == pytest.approx(after[name], rel=3e-5)
        assert change.ratio == pytest.approx(after[name] / before[name], rel=5e-5)
        assert change.low <= change.ratio <= change.high


def test_what_is_proposed_is_better_than_today_with_the_true_plant(proposed):
    assert proposed.best
    assert proposed.best == proposed.comparison.gains
    assert set(proposed.best) == {"K_P", "K_D"}
    assert proposed.comparison.bandwidth > proposed.today_bandwidth
    gains = TODAY | proposed.best
    before, after = by_hand(TRUTH, TODAY), by_hand(TRUTH, gains)
    assert all(after[name] < before[name] for name in before)

    # The same in virtual flights: a step moment, and noise of the gyro.
    step = {"u": np.full(1000, 0.1)}
    true = TRUTH | {"tau": DELAY / RATE}
    peaks, noises = [], []
    for law in (RateLoopWithD(TODAY), RateLoopWithD(gains)):
        flight = gb.virtual_flight(RateDynamics(), true, step, controller=law)
        peaks.append(np.abs(flight["q"]).max())
        rest = {"u": np.zeros(4000)}
        flight = gb.virtual_flight(RateDynamics(), true, rest, controller=law, noise={"q": 0.1})
        noises.append(flight["u"].std())
    changes = proposed.comparison
    assert peaks[1] / peaks[0] == pytest.approx(changes[MOMENT].ratio, rel=0.01)
    assert noises[1] / noises[0] == pytest.approx(changes[NOISE].ratio, rel=0.01)


def test_no_faster_set_that_is_as_good_is_passed_over(proposed):
    better = proposed.faster & (proposed.bandwidth > proposed.comparison.bandwidth)
    assert better.any()
    before = by_hand(fitted().estimate, TODAY)
    for row in np.argwhere(better):
        gains = TODAY | {n: v[k] for (n, v), k in zip(proposed.values.items(), row, strict=True)}
        after = by_hand(fitted().estimate, gains)
        assert max(after[name] / before[name] for name in before) > 0.999


@pytest.mark.usefixtures("one_set")
def test_a_set_is_refused_where_the_plant_is_too_uncertain():
    """The same set, at two sizes of the errors: it may be worse with the larger one."""
    sure, unsure = (
        gb.safe_gains(
            fitted(noise=noise), RateLoopWithD(TODAY), ONE, phase_margin=30, gain_margin=3
        )
        for noise in (0.01, 0.18)
    )
    assert sure.best
    assert unsure.best == {}
    assert unsure.allowed.any()
    change = unsure.comparison[SENSITIVITY]
    assert change.ratio < 1 < change.high
    assert change.judgement == "may be worse"
    assert "may be worse" in str(unsure)
    assert unsure.verdict.startswith("keep today's gains: ")


@pytest.mark.usefixtures("one_set")
def test_every_flight_must_be_as_good():
    options = {"phase_margin": 20, "gain_margin": 2}
    flights = fitted(), fitted(gain=20.0)
    law = RateLoopWithD(TODAY)
    light, heavy = (gb.safe_gains(fit, law, ONE, **options).comparison for fit in flights)
    both = gb.safe_gains(flights, law, ONE, **options).comparison
    for name in (SENSITIVITY, MOMENT, NOISE):
        highest = max(light[name].high, heavy[name].high)
        assert both[name].high == pytest.approx(highest, rel=0.01)


class TwoGyros(gb.StateSpace):
    """The rate, and a second gyro of unknown scale whose signal the flight did not record."""

    states, inputs, outputs = ("q", "rotor"), ("u",), ("q", "second")
    delays = {"u": "tau"}
    K = gb.Parameter(20.0, bounds=(1, 1000))
    a = gb.Parameter(2.0, bounds=(0, 5))  # slower than the rotor
    T = gb.Parameter(0.05, bounds=(0.001, 0.1))
    tau = gb.Parameter(TRUTH["tau"], bounds=(0, 0.2))
    scale = gb.Parameter(1.0, bounds=(0.5, 2))

    def derivative(self, x, u, p):
        return (p.K * x.rotor - p.a * x.q, (u.u - x.rotor) / p.T)

    def output(self, x, u, p):
        return (x.q, p.scale * x.q)


def test_what_the_data_do_not_determine_gets_no_proposal():
    law = RateLoopWithD(TODAY, signals={"q": "second"})
    answers = []
    data = fitted().parts[0].data
    for fixed in ({"scale": 1.0}, {}):
        problem = gb.Problem(TwoGyros(), data, gb.MaximumLikelihood(), fixed=fixed)
        fit = gb.fit(problem, starts=2, progress=False)
        answers.append(gb.safe_gains(fit, law, NARROW))
    known, unknown = answers
    assert known.best
    assert unknown.allowed.any()
    assert unknown.best == {}
    assert "(not determined)" in str(unknown)


class TwoAxes(gb.StateSpace):
    """Two rates, each with its own control; the first one drives the second one a little."""

    states, inputs, outputs = ("p", "q"), ("aileron", "elevator"), ("p", "q")
    K = gb.Parameter(20.0, bounds=(1, 100))
    a = gb.Parameter(2.0, bounds=(0, 20))

    def derivative(self, x, u, p):
        return (p.K * u.aileron - p.a * x.p, p.K * u.elevator - p.a * x.q + 0.1 * x.p)

    def output(self, x, u, p):
        return (x.p, x.q)


class Rates(gb.Controller):
    """Proportional control of both."""

    inputs, outputs, rate = ("p", "q"), ("aileron", "elevator"), RATE
    setpoints = ()
    K_P = gb.Parameter(0.3, bounds=(0, 10))

    def update(self, x, u, p):
        return (), (-p.K_P * u.p, -p.K_P * u.q)


def test_every_driven_input_and_every_measured_signal_counts():
    omega = np.geomspace(1, 60, 20)
    errors = 1 + 0.01 * np.random.default_rng(0).normal(size=(2, 20)).T @ [1, 1j]
    data = gb.FrequencyResponse(omega, 20 / (1j * omega + 2) * errors, "aileron", "p")
    fit = gb.fit(gb.Problem(TwoAxes(), data), starts=2, progress=False)
    comparison = gb.safe_gains(fit, Rates(), {"K_P": (0.4, 0.6)}).comparison
    names = [change.name for change in comparison.changes]
    assert len(names) == 1 + 4 + 4
    # A larger gain: each moment moves its rate less, and noise is amplified on both axes.
    for axis, control in (("p", "aileron"), ("q", "elevator")):
        gains = [0.3, comparison.gains["K_P"]]
        moment = comparison[f"peak {axis} after a step moment at {control}"]
        # The rate at the end: K / (a + K gain).
        rest = [20 / (fit.estimate["a"] + fit.estimate["K"] * gain) for gain in gains]
        assert moment.ratio == pytest.approx(rest[1] / rest[0], rel=1e-3)
        assert comparison[f"noise from {axis} to {control}"].ratio > 1
    # The elevator does not move the roll rate: nothing over nothing is not worse.
    assert comparison["peak p after a step moment at elevator"].is_not_worse


def test_a_loop_that_is_unstable_today_is_no_measure():
    unstable = RateLoop({"K_P": 3.0})
    answer = gb.safe_gains(fitted(), unstable, {"K_P": (0.1, 0.2)})
    assert answer.allowed.any()
    assert answer.best == {}
    assert not answer.is_usable
    assert answer.verdict.startswith("refused: the loop of today's gains is unstable")
    assert "If they fly, the model or the gains are wrong" in str(answer)
    assert "peak |S|" not in str(answer)
    json.dumps(answer.to_dict(), allow_nan=False)


def test_today_is_kept_if_nothing_rejects_disturbances_better():
    answer = gb.safe_gains(fitted(), RateLoop({"K_P": 0.25, "K_I": 0.1}), {"K_P": (0.1, 0.2)})
    assert answer.comparison is None
    assert answer.is_usable
    assert "no set that meets the requirements has a higher disturbance" in answer.verdict
    fields = answer.to_dict()
    assert (fields["best"], fields["comparison"]) == (None, None)
    assert fields["reason"] == fields["verdict"]


def test_text_and_plain_values_say_the_same(proposed):
    fields = json.loads(json.dumps(proposed.to_dict(), allow_nan=False))
    assert fields["best"] == proposed.best == fields["comparison"]["gains"]
    assert fields["reason"] is None
    assert fields["comparison"]["worse"] == []
    rows = {row["name"]: row for row in fields["comparison"]["changes"]}
    assert [*rows] == [SENSITIVITY, MOMENT, NOISE]
    first, *lines = str(proposed).splitlines()
    assert first.startswith("Proposed: K_P = ")
    sensitivity, moment = (
        next(line for line in lines if line.startswith(name)) for name in (SENSITIVITY, MOMENT)
    )
    assert f"{20 * np.log10(rows[SENSITIVITY]['today']):.3g}" in sensitivity
    assert f"{100 * (rows[MOMENT]['low'] - 1):.3g} to " in moment
    assert "not worse" in moment


@functools.cache
def pitch():
    """The fit of the included log, the log, and what it says about gains."""
    fit = gb.fit(sitl_pitch.problem(), starts=1, profiles=False, progress=False)
    log = gb.read(sitl_pitch.LOG)
    return fit, log, safe_gains_of_log([fit], log)


def test_the_included_log_keeps_its_gains():
    """The set with the highest bandwidth lets a moment move the vehicle twice as far."""
    *_, answer = pitch()
    assert answer.best == {}
    assert str(answer).startswith("Keep today's gains")
    assert set(answer.comparison.gains) == {"ATC_RAT_PIT_P", "ATC_RAT_PIT_D"}
    assert answer.comparison.bandwidth > 2 * answer.today_bandwidth
    assert answer.comparison["peak theta after a step moment at u"].low > 1.5
    assert answer.comparison["noise from theta_dot to u"].low > 2


def test_the_numbers_of_the_flown_chain_are_those_of_flights_of_the_true_plant():
    """With the filters of the gyro and the delays; the physics of this simulator are known."""
    fit, log, answer = pitch()
    flown, _ = flown_controllers(log, fit)
    names = {"ATC_RAT_PIT_P": "P", "ATC_RAT_PIT_D": "D"}
    changed = {names[name]: value for name, value in answer.comparison.gains.items()}
    chains = [flown.controllers]
    chains.append([_with(law, changed) if law is flown.law else law for law in flown.controllers])
    truth = sitl_pitch.published["values"] | {"T_delay": 0.0}
    peaks, noises = [], []
    for chain in chains:
        step = {"u": np.full(1600, 1e-3)}
        flight = gb.virtual_flight(fit.model_of(), truth, step, controller=chain)
        peaks.append(np.abs(flight["theta"]).max())
        rest = {"u": np.zeros(8000)}
        gyro = {"theta_dot": 1e-4}
        flight = gb.virtual_flight(fit.model_of(), truth, rest, controller=chain, noise=gyro)
        noises.append(flight["u"].std() / 1e-4)
    for numbers, name, tolerance in (
        (peaks, "peak theta after a step moment at u", 0.03),
        (noises, "noise from theta_dot to u", 0.1),
    ):
        unit = 1e-3 if numbers is peaks else 1.0
        change = answer.comparison[name]
        assert change.today == pytest.approx(numbers[0] / unit, rel=tolerance)
        assert change.changed == pytest.approx(numbers[1] / unit, rel=tolerance)
        assert change.ratio == pytest.approx(numbers[1] / numbers[0], rel=tolerance)


def _with(law, gains):
    return type(law)({**law.values, **gains}, rate=law.rate, signals=law.signals)
