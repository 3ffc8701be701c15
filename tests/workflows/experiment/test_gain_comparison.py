"""Gains against today's, held against hand-written loops and virtual flights of the true plant."""

import functools
import json
from importlib import import_module

import numpy as np
import pytest
from rate_control import RATE, RateDynamics, RateLoop, RateLoopWithD
from scipy.signal import cont2discrete, tf2ss

import greybox as gb
from greybox.models.firmware import (
    flown_controllers,
    logged_disturbances,
    safe_gains_of_log,
    white_noise,
)
from greybox.problems import sitl_pitch
from greybox.workflows.experiment.gain_objectives import shelf
from greybox.workflows.experiment.sampled_loop import sampled_loop
from greybox.workflows.experiment.todays_loop import todays_loop

pytestmark = pytest.mark.usefixtures("few_draws", "unjudged_file")

DELAY = 2  # samples; the response contains half a sample more, that of the held control
TRUTH = {"K": 40.0, "a": 2.0, "T": 0.05, "tau": (DELAY + 0.5) / RATE}
TODAY = {"K_P": 0.15, "K_I": 0.3, "K_D": 0.012}
SLUGGISH = {"K_P": 0.1, "K_I": 0.02, "K_D": 0.003}
SENSITIVITY, PEAK, RMS, NOISE = (
    "peak |S|",
    "peak of q from a moment at u",
    "rms of q from a moment at u",
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
    """Three of the numbers, each by another way than the one under test."""
    return {
        SENSITIVITY: 20 * np.log10(sensitivity_peak(values, gains)),
        PEAK: np.abs(simulated(values, gains, moment=1.0)[0]).max(),
        # The sum of the squared response to a single error is the variance from white noise.
        NOISE: np.sqrt(np.sum(simulated(values, gains, impulse=1.0)[1] ** 2)),
    }


@functools.cache
def answer_for_sluggish_gains():
    return gb.safe_gains(fitted(), RateLoopWithD(SLUGGISH), ["K_P", "K_D"], noise_factor=2.5)


@pytest.fixture
def one_set(few_draws, monkeypatch):
    """Try the first value of every range alone."""
    # By its path: `greybox.workflows.experiment.safe_gains` is the function.
    module = import_module("greybox.workflows.experiment.safe_gains")
    monkeypatch.setattr(module, "POINTS", {2: 1})


@pytest.fixture
def proposed():
    return answer_for_sluggish_gains()


def loops_of(gains, **truth):
    values = np.array([[*RateDynamics().values(TRUTH | {"tau": DELAY / RATE} | truth).values()]])
    return sampled_loop(RateDynamics(), values, RateLoopWithD(gains))


@pytest.mark.parametrize(
    "today",
    [TODAY, {"K_P": 0.4, "K_I": 2.0, "K_D": 0.0}, {"K_P": 0.15, "K_I": 0.01, "K_D": 0.001}],
    ids=["much D", "hardly stable", "slow integral"],
)
def test_the_numbers_are_those_of_loops_written_by_hand(today):
    other = {name: 0.7 * value for name, value in today.items()}
    loops = loops_of(today)
    judge = todays_loop([RateLoopWithD(today)], loops, 0, "u")
    objective, changes = judge.changes(loops_of(other).controller, 0.95)
    rows = {change.name: change for change in changes}
    before, after = by_hand(TRUTH, today), by_hand(TRUTH, other)
    for name in (SENSITIVITY, PEAK, NOISE):
        assert rows[name].today == pytest.approx(before[name], rel=3e-5)
        assert rows[name].changed == pytest.approx(after[name], rel=3e-5)
    factor = 10 ** ((after[SENSITIVITY] - before[SENSITIVITY]) / 20)
    assert rows[SENSITIVITY].worsening == pytest.approx(factor, rel=1e-4)
    assert rows[NOISE].worsening == pytest.approx(after[NOISE] / before[NOISE], rel=1e-4)

    # The integral of the squared response, over five periods of the crossover of today's loop.
    crossover = gb.margins(RateDynamics(), RateLoopWithD(today), TRUTH | {"tau": DELAY / RATE})[
        "crossover"
    ].value
    assert judge.horizon == pytest.approx(10 * np.pi / crossover, rel=1e-3)
    samples = round(judge.horizon * RATE) + 1
    sizes = [
        np.sqrt(np.mean(simulated(TRUTH, gains, moment=1.0, samples=samples)[0] ** 2))
        for gains in (today, other)
    ]
    assert rows[RMS].today == pytest.approx(sizes[0], rel=0.02)
    assert objective.worsening == pytest.approx(sizes[1] / sizes[0], rel=0.01)


def test_what_is_called_better_is_better_with_the_true_plant(proposed):
    assert proposed.best == proposed.comparison.gains
    assert set(proposed.best) == {"K_P", "K_D"}
    gains = SLUGGISH | proposed.best
    before, after = by_hand(TRUTH, SLUGGISH), by_hand(TRUTH, gains)
    better = {change.name for change in proposed.comparison.judged("better")}
    assert {RMS, PEAK} <= better
    assert after[PEAK] < before[PEAK]
    assert after[NOISE] < 2.52 * before[NOISE]
    assert max(after[SENSITIVITY], before[SENSITIVITY], 3.0) < 3.1
    assert all(0.5 <= gains[name] / SLUGGISH[name] <= 2.0 + 1e-9 for name in proposed.best)

    true, laws = TRUTH | {"tau": DELAY / RATE}, (RateLoopWithD(SLUGGISH), RateLoopWithD(gains))
    margins = [gb.margins(RateDynamics(), law, true) for law in laws]
    assert margins[1]["phase margin"].value > 45
    if "disturbance rejection bandwidth" in better:
        assert margins[1]["disturbance rejection bandwidth"].value > (
            margins[0]["disturbance rejection bandwidth"].value
        )

    # The same in virtual flights: a step moment, and noise of the gyro.
    step = {"u": np.full(1000, 0.1)}
    peaks, noises = [], []
    for law in laws:
        flight = gb.virtual_flight(RateDynamics(), true, step, controller=law)
        peaks.append(np.abs(flight["q"]).max())
        rest = {"u": np.zeros(4000)}
        flight = gb.virtual_flight(RateDynamics(), true, rest, controller=law, noise={"q": 0.1})
        noises.append(flight["u"].std())
    changes = proposed.comparison
    assert peaks[1] / peaks[0] == pytest.approx(changes[PEAK].worsening, rel=0.03)
    assert noises[1] / noises[0] == pytest.approx(changes[NOISE].worsening, rel=0.03)


def test_the_steps_lead_to_the_proposed_gains_in_equal_ratios(proposed):
    first, second, last = proposed.steps
    assert last == proposed.best
    for name, today in proposed.today.items():
        ratios = [first[name] / today, second[name] / first[name], last[name] / second[name]]
        assert ratios == pytest.approx([(last[name] / today) ** (1 / 3)] * 3)


def test_a_row_that_gets_worse_is_in_the_first_sentence(proposed):
    rows = [*proposed.comparison.judged("worse"), *proposed.comparison.judged("may be worse")]
    assert rows
    first, *_ = str(proposed).splitlines()
    assert all(change.name in first for change in rows)
    assert NOISE in {change.name for change in rows}


def test_gains_change_by_more_than_a_factor_of_two_only_if_asked_to():
    ranges = {"K_P": (0.21, 0.3), "K_D": (0.003, 0.0035)}
    near = gb.safe_gains(fitted(), RateLoopWithD(SLUGGISH), ranges, noise_factor=9)
    assert near.allowed.any()
    assert near.best == {}
    assert "changes K_P by more than a factor of 2" in near.verdict
    far = gb.safe_gains(fitted(), RateLoopWithD(SLUGGISH), ranges, noise_factor=9, change=4)
    assert far.best["K_P"] > 0.2


def test_more_noise_than_stated_is_refused():
    ranges = {"K_P": (0.19, 0.2), "K_D": (0.005, 0.006)}
    little = gb.safe_gains(fitted(), RateLoopWithD(SLUGGISH), ranges)
    assert little.best == {}
    assert str(little).startswith("Keep today's gains: ")
    assert any(
        "times today's noise at the actuator (the limit is 1.5), K_P = " in n for n in little.notes
    )


@pytest.mark.usefixtures("one_set")
def test_an_uncertain_plant_gets_no_proposal_where_a_certain_one_does():
    gains = {"K_P": (0.183, 0.2), "K_D": (0.003, 0.0035)}
    law = RateLoopWithD(SLUGGISH)
    sure, unsure = (
        gb.safe_gains(fitted(noise=n), law, gains, phase_margin=30, gain_margin=3, noise_factor=9)
        for n in (0.01, 0.18)
    )
    assert sure.best
    assert unsure.best == {}
    assert unsure.verdict.startswith("keep today's gains: ")


@pytest.mark.usefixtures("one_set")
def test_every_flight_must_be_as_good():
    options = {"phase_margin": 20, "gain_margin": 2}
    flights = fitted(), fitted(gain=20.0)
    law, one = RateLoopWithD(TODAY), {"K_P": (0.178, 0.2), "K_D": (0.00948, 0.012)}
    light, heavy = (gb.safe_gains(fit, law, one, **options).comparison for fit in flights)
    both = gb.safe_gains(flights, law, one, **options).comparison
    for name in (SENSITIVITY, PEAK, NOISE):
        highest = max(light[name].high, heavy[name].high)
        assert both[name].high == pytest.approx(highest, rel=0.01)


class Limited(RateLoopWithD):
    """The controller with a limit of the control."""

    def update(self, x, u, p):
        following, (control,) = super().update(x, u, p)
        return following, (gb.maximum(-0.06, gb.minimum(0.06, control)),)


@pytest.mark.parametrize(("noise", "is_proposed"), [(1e-3, True), (0.08, False)])
def test_gains_that_saturate_more_often_in_flights_are_refused(noise, is_proposed):
    """The noise reaches the limit with more than twice today's noise gain, and not with today's."""
    ranges = {"K_P": (0.19, 0.2), "K_D": (0.0055, 0.006)}
    options = {"noise": {"q": noise}, "moment": 1e-3, "noise_factor": 2.5}
    answer = gb.safe_gains(fitted(), Limited(SLUGGISH), ranges, **options)
    assert bool(answer.best) == is_proposed
    flights, today = answer.comparison.flights, answer.comparison.today_flights
    assert flights.is_worse_than(today) != is_proposed
    assert f"{flights.saturating} reach a limit" in str(answer)
    if not is_proposed:
        assert flights.saturating > today.saturating
        assert "reaches a limit of the control or rings more often" in answer.verdict


def test_any_function_of_a_loop_can_be_the_objective():
    """At 0.05 rad/s, where a larger integral helps."""

    def slow_response(loop):
        return np.abs(loop.gains("u", ["q"], [0.05])[:, 0, 0])

    options = {"objective": slow_response, "noise_factor": 3}
    answer = gb.safe_gains(fitted(), RateLoopWithD(SLUGGISH), {"K_I": (0.012, 0.04)}, **options)
    assert answer.aim == "slow_response"
    assert answer.best["K_I"] > 0.024
    assert answer.comparison.objective.high < 0.76


def test_a_shelf_of_the_sensitivity_is_said():
    """With much D and little P, |S| stays just below -3 dB over more than an octave."""
    gains = {"K_P": 0.07, "K_I": 0.02, "K_D": 0.0115}
    loops = loops_of(gains)
    begin, end = shelf(loops, "u")
    omega = np.geomspace(begin * 1.02, end * 0.98, 50)
    size = np.abs(loops.gains("u", ["u"], omega)[0, :, 0])
    assert np.all((size > 0.5) & (size < np.sqrt(0.5)))
    assert end > 2 * begin
    assert shelf(loops_of(SLUGGISH), "u") is None
    fit, law = fitted(), RateLoopWithD(gains)
    bandwidth = gb.experiment.RejectionBandwidth()
    answer = gb.safe_gains(fit, law, ["K_P"], objective=bandwidth, phase_margin=0, gain_margin=0)
    assert answer.aim == "disturbance rejection bandwidth"
    assert any("the disturbance rejection bandwidth says little" in note for note in answer.notes)


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
    law = RateLoopWithD(SLUGGISH, signals={"q": "second"})
    answers = []
    data = fitted().parts[0].data
    for fixed in ({"scale": 1.0}, {}):
        problem = gb.Problem(TwoGyros(), data, gb.MaximumLikelihood(), fixed=fixed)
        fit = gb.fit(problem, starts=2, progress=False)
        answers.append(gb.safe_gains(fit, law, ["K_P", "K_D"], noise_factor=2.5))
    known, unknown = answers
    assert known.best
    assert unknown.allowed.any()
    assert unknown.best == {}
    assert "that the data do not determine" in str(unknown)


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
    values = np.array([[20.0, 2.0]])
    gains = 0.3, 0.4
    loops, other = (sampled_loop(TwoAxes(), values, Rates({"K_P": gain})) for gain in gains)
    today = todays_loop([Rates({"K_P": gains[0]})], loops, 0, "aileron")
    objective, changes = today.changes(other.controller, 0.95)
    rows = {change.name: change for change in changes}
    # A larger gain: each moment moves its rate less, and noise is amplified on both axes.
    for axis, control in (("p", "aileron"), ("q", "elevator")):
        moment = rows[f"peak of {axis} from a moment at {control}"]
        # The rate at the end: K / (a + K gain).
        rest = [20 / (2 + 20 * gain) for gain in gains]
        assert moment.worsening == pytest.approx(rest[1] / rest[0], rel=1e-3)
        assert rows[f"noise from {axis} to {control}"].worsening > 1
    # The elevator does not move the roll rate: nothing over nothing is not worse.
    assert rows["peak of p from a moment at elevator"].worsening == 1
    assert objective.worsening < 0.9


def test_a_loop_that_is_unstable_today_is_no_measure():
    unstable = RateLoop({"K_P": 3.0})
    answer = gb.safe_gains(fitted(), unstable, {"K_P": (0.1, 0.2)})
    assert answer.allowed.any()
    assert answer.best == {}
    assert not answer.is_usable
    assert answer.verdict.startswith("refused: the loop of today's gains is unstable")
    assert "If they fly, the model or the gains are wrong" in str(answer)
    assert "to a moment" not in str(answer)
    json.dumps(answer.to_dict(), allow_nan=False)


def test_today_is_kept_if_nothing_is_better():
    answer = gb.safe_gains(fitted(), RateLoop({"K_P": 0.25, "K_I": 0.1}), {"K_P": (0.1, 0.2)})
    assert answer.comparison is None
    assert answer.is_usable
    assert answer.verdict.startswith("keep today's gains: no other set")
    fields = answer.to_dict()
    assert (fields["best"], fields["comparison"]) == (None, None)
    assert fields["reason"] == fields["verdict"]


def test_text_and_plain_values_say_the_same(proposed):
    fields = json.loads(json.dumps(proposed.to_dict(), allow_nan=False))
    assert fields["best"] == proposed.best == fields["comparison"]["gains"]
    assert fields["steps"] == [*proposed.steps]
    assert fields["reason"] is None
    assert fields["comparison"]["refusals"] == []
    rows = {row["name"]: row for row in fields["comparison"]["changes"]}
    assert {SENSITIVITY, PEAK, RMS, NOISE, "phase margin", "rise time of q"} <= {*rows}
    first, *lines = str(proposed).splitlines()
    assert first.startswith("Proposed: K_P = ")
    sensitivity, peak = (
        next(line for line in lines if line.startswith(name)) for name in (SENSITIVITY, PEAK)
    )
    assert f"{rows[SENSITIVITY]['today']:.3g}" in sensitivity
    assert f"{100 * (rows[PEAK]['changed'] / rows[PEAK]['today'] - 1):.3g} %" in peak
    # Rows stand below what they are.
    above = lines[: lines.index(peak)]
    assert [line for line in above if line.endswith(":")][-1] == f"{rows[PEAK]['judgement']}:"


@functools.cache
def pitch():
    """The fit of the included log, the log, and what it says about gains."""
    fit = gb.fit(sitl_pitch.problem(), starts=1, profiles=False, progress=False)
    log = gb.read(sitl_pitch.LOG)
    return fit, log, safe_gains_of_log([fit], log)


def test_the_included_log_keeps_its_gains():
    """Its loop is well tuned: the phase margin is 46 degrees, and less response is more noise."""
    *_, answer = pitch()
    assert answer.best == {}
    assert str(answer).startswith("Keep today's gains")
    assert "the best other set lowers the response" in answer.verdict
    assert set(answer.comparison.gains) == {"ATC_RAT_PIT_P", "ATC_RAT_PIT_D"}


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
        (peaks, "peak of theta from a moment at u", 0.03),
        (noises, "noise from theta_dot to u", 0.1),
    ):
        unit = 1e-3 if numbers is peaks else 1.0
        change = answer.comparison[name]
        assert change.today == pytest.approx(numbers[0] / unit, rel=tolerance)
        assert change.changed == pytest.approx(numbers[1] / unit, rel=tolerance)
        assert change.worsening == pytest.approx(numbers[1] / numbers[0], rel=tolerance)


def test_disturbances_of_simulated_flights_are_those_of_the_log():
    """White noise in slow samples is measured, and the moment is as large as the logged control."""
    fit, log, _ = pitch()
    flown, _ = flown_controllers(log, fit)
    sizes = logged_disturbances(flown, log, fit)
    control = flown.record(log)["u"]
    assert 0.5 * np.abs(control).max() < sizes["moment"] <= 1.1 * np.abs(control).max()
    assert 0 < sizes["noise"]["theta_dot"] < 0.1
    random = np.random.default_rng(0)
    slow = np.sin(0.1 * np.arange(20_000)) + 0.01 * random.normal(size=20_000)
    assert white_noise(slow) == pytest.approx(0.01, rel=0.05)


def _with(law, gains):
    return type(law)({**law.values, **gains}, rate=law.rate, signals=law.signals)
