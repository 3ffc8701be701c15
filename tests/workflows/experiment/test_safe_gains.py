"""Safe gains, held against the true loops of python-control."""

import functools
from importlib import import_module

import control
import numpy as np
import pytest
from rate_control import RATE, RateDynamics, RateLoopWithD

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {"K": 40.0, "a": 2.0, "T": 0.05, "tau": 0.03}


class RateLoop(gb.Controller):
    """Proportional control of the rate."""

    inputs, outputs, rate = ("q",), ("u",), RATE
    K_P = gb.Parameter(0.15, bounds=(0, 10))

    def update(self, x, u, p):
        return (), (p.K_P * (u.reference - u.q),)


@functools.cache
def fitted(seed, noise=0.03, lowest=0.5, highest=40.0):
    """A fit to a measured response, whose delay includes half a sample of the held control."""
    omega = np.geomspace(lowest, highest, 40)
    exact = gb.frequency_response(
        RateDynamics(), {**TRUTH, "tau": TRUTH["tau"] + 0.5 / RATE}, omega
    )
    rng = np.random.default_rng(seed)
    errors = noise * (rng.normal(size=omega.size) + 1j * rng.normal(size=omega.size))
    variance = 2 * noise**2 * np.abs(exact.response) ** 2
    data = gb.FrequencyResponse(
        omega, exact.response * (1 + errors), "u", "q", variance=variance, name=f"flight {seed}"
    )
    return gb.fit(
        gb.Problem(RateDynamics(), data, gb.MaximumLikelihood()), starts=2, progress=False
    )


def truly_safe(gain, phase_margin=45, gain_margin=6, delay=0.0):
    """Whether the true loop has the margins: plant by zero-order hold and three samples of delay."""
    denominator = np.polymul([1, TRUTH["a"]], [TRUTH["T"], 1])
    plant = control.c2d(control.tf([TRUTH["K"]], denominator), 1 / RATE)
    loop = gain * plant * control.tf([1], [1, 0, 0, 0], 1 / RATE)
    if np.any(np.abs(control.feedback(loop, 1).poles()) >= 1):
        return False
    omega = np.geomspace(0.05, 0.99 * np.pi * RATE, 2000)
    response = loop(np.exp(1j * omega / RATE)) * np.exp(-1j * omega * delay)
    crosses = np.flatnonzero(np.diff(np.abs(response) > 1))
    phase = 180 - np.abs(np.degrees(np.angle(response[crosses])))
    real = np.flatnonzero(np.diff(response.imag > 0) & (response.real[:-1] < 0))
    decibels = np.abs(20 * np.log10(np.abs(response[real])))
    return bool(np.all(phase >= phase_margin) and np.all(decibels >= gain_margin))


def highest(answer):
    """The highest of the allowed gains."""
    return answer.values["K_P"][answer.allowed].max()


@pytest.fixture(scope="module", autouse=True)
def half_the_draws():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("greybox.workflows.experiment.safe_gains"), "DRAWS", 128)
        yield


@pytest.fixture(scope="module")
def answers():
    return [gb.safe_gains(fitted(seed), RateLoop(), {"K_P": (0.02, 1.0)}) for seed in range(3)]


def test_allowed_gains_meet_the_requirements_in_truth_and_others_are_refused(answers):
    gains = answers[0].values["K_P"]
    safe = np.array([truly_safe(gain) for gain in gains])
    allowed = np.array([answer.allowed for answer in answers])
    assert np.mean(~safe[np.nonzero(allowed)[1]]) <= 0.05
    assert np.mean(~allowed[:, ~safe]) >= 0.95
    # Safe gains that are refused lie beside the limit.
    inside = safe & (gains < 0.85 * gains[safe].max())
    assert allowed[:, inside & (gains > 0.1)].all()


@pytest.mark.usefixtures("few_draws")
def test_the_confidence_in_todays_gains_is_printed_in_percent(answers):
    best = highest(answers[0])
    finer = gb.safe_gains(fitted(0), RateLoop(), {"K_P": (best, 1.05 * best)})
    refused = finer.values["K_P"][~finer.allowed].min()
    answer = gb.safe_gains(fitted(0), RateLoop({"K_P": refused}), {"K_P": (0.1, 0.2)})
    assert 0 < answer.today_confidence < 0.95
    assert f" with {100 * answer.today_confidence:.3g} % confidence" in str(answer)


@pytest.mark.usefixtures("few_draws")
def test_a_record_shows_where_it_was_measured_and_where_not():
    truth = {**TRUTH, "K": 4.0, "tau": 0.0}
    time = np.arange(0, 30, 0.02)
    sweep = 0.3 * np.sign(np.sin(2 * np.pi * (0.1 + 0.05 * time) * time))
    flight = gb.Record(time, {"u": sweep}, hold={"u": np.inf})
    q = gb.simulate(RateDynamics(), truth, flight)["q"]
    flight = flight.with_signals(q=q + 0.01 * np.random.default_rng(0).normal(size=q.size))
    fit = gb.fit(gb.Problem(RateDynamics(), flight), starts=2, progress=False)
    answer = gb.safe_gains(fit, RateLoop({"K_P": 0.01}), {"K_P": (0.7, 1.5)})
    assert answer.allowed.any()
    # With so little gain there is no crossover in the band of the sweep.
    assert np.isnan(answer.today_confidence)
    assert "today's gains meet them is not known" in str(answer)


def test_the_allowed_gain_that_responds_least_is_compared_with_today(answers):
    """It is refused: today's gain is good, and a larger one makes the sensitivity too large."""
    answer = answers[0]
    assert 0.15 < answer.comparison.gains["K_P"] <= highest(answer)
    assert answer.comparison.objective.worsening < 1
    assert answer.comparison.refusals
    assert answer.best == {}
    assert answer.today == {"K_P": 0.15}
    assert answer.today_confidence == 1.0
    assert str(answer).startswith("Keep today's gains: ")
    assert "At an end" not in str(answer)


@pytest.mark.usefixtures("few_draws")
def test_half_to_twice_todays_gain_is_tried_without_a_range():
    tried = gb.safe_gains(fitted(0), RateLoop(), ["K_P"]).values["K_P"]
    assert tried[[0, -1]] == pytest.approx([0.15 / 2, 0.15 * 2])
    tried = gb.safe_gains(fitted(0), RateLoop(), ["K_P"], change=4).values["K_P"]
    assert tried[[0, -1]] == pytest.approx([0.15 / 4, 0.15 * 4])


@pytest.mark.usefixtures("few_draws")
def test_a_proposed_gain_at_an_end_of_the_range_is_named():
    law = RateLoopWithD({"K_P": 0.1, "K_I": 0.02, "K_D": 0.003})
    gains = {"K_P": (0.15, 0.2), "K_D": (0.002, 0.006)}
    narrow = gb.safe_gains(fitted(0), law, gains, noise_factor=2.5)
    assert "At an end of the tried range: the proposed K_P" in str(narrow)
    assert "Not promised: structural modes" in str(narrow)


def test_unmodeled_delay_and_a_second_flight_leave_fewer_gains(answers):
    late = gb.safe_gains(fitted(0), RateLoop(), {"K_P": (0.02, 1.0)}, delay=0.03)
    assert late.allowed.sum() < answers[0].allowed.sum()
    assert truly_safe(0.95 * highest(late), delay=0.03)
    assert not truly_safe(1.2 * highest(late), delay=0.03)
    both = gb.safe_gains([fitted(0), fitted(1)], RateLoop(), {"K_P": (0.02, 1.0)})
    assert np.array_equal(both.allowed, answers[0].allowed & answers[1].allowed)


class Fast(gb.StateSpace):
    """A rate whose control works with the square of the speed."""

    states, inputs, outputs = ("q", "speed"), ("u",), ("q",)
    K = gb.Parameter(10.0, bounds=(1, 100))
    a = gb.Parameter(2.0, bounds=(0, 20))

    def derivative(self, x, u, p):
        return (p.K * x.speed**2 * u.u - p.a * x.q, 0 * x.speed)

    def output(self, x, u, p):
        return (x.q,)


@pytest.mark.usefixtures("few_draws")
def test_parts_of_a_fit_are_flights_and_the_operating_point_counts():
    omega = np.geomspace(1, 60, 20)
    errors = 1 + 0.01 * np.random.default_rng(0).normal(size=(2, 20)).T @ [1, 1j]

    def problem(K, **options):
        data = gb.FrequencyResponse(omega, K / (1j * omega + 2) * errors, "u", "q")
        return gb.Problem(Fast(), data, at={"speed": 1.0}, **options)

    both = problem(20.0) + problem(5.0, rename={"K": "K_heavy"})
    fit = gb.fit(both, starts=2, progress=False)
    light, slow, fast = (
        highest(gb.safe_gains(fit, RateLoop(), {"K_P": (0.5, 50.0)}, **options))
        for options in ({}, {"parts": [1]}, {"parts": [1], "at": {"speed": 2.0}})
    )
    # Twice the speed is four times the gain, that of the light vehicle.
    assert fast == light < slow


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize(
    "data",
    [
        {"noise": 0.4},  # a random error of 40 %
        {"lowest": 0.2, "highest": 1.5},
    ],
)
def test_a_response_that_was_measured_poorly_at_the_crossover_is_refused(data):
    answer = gb.safe_gains(fitted(0, **data), RateLoop(), {"K_P": (0.1, 0.2)})
    assert not answer.allowed.any()
    assert answer.best == {}
    assert answer.verdict.startswith("refused: the")
    assert str(answer).startswith("Refused: the")
    assert "In the conditions of 'flight 0', fly sines or a sweep from " in answer.cure


@pytest.mark.usefixtures("few_draws")
def test_a_record_tells_which_crossovers_it_has_excited():
    """From 1 to 30 rad/s: gains below 0.06 cross below 1.3 rad/s, and those above 0.35 are not safe."""
    reference = gb.experiment.multisine(1.0, 30.0, 10.0, RATE, signals=["reference"], periods=2)
    noise = {"noise": {"q": 0.02}, "seed": 1}
    record = gb.virtual_flight(RateDynamics(), TRUTH, reference, controller=RateLoop(), **noise)
    problem = gb.Problem(RateDynamics(), record, gb.OutputError(inputs="held"))
    fit = gb.fit(problem, starts=[TRUTH], profiles=False, progress=False)
    answer = gb.safe_gains(fit, RateLoop(), {"K_P": (0.05, 0.4)})
    gains = answer.values["K_P"]
    assert np.isnan(answer.confidence[gains < 0.06]).all()
    assert answer.allowed[(gains > 0.12) & (gains < 0.33)].all()
    assert not answer.allowed[gains > 0.35].any()
    assert [truly_safe(gain) for gain in (0.33, 0.36)] == [True, False]


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        ({"K_Q": (0, 1)}, "no gain 'K_Q'"),
        ({"K_P": (1, 0.1)}, "must be increasing: got 1 to 0.1"),
        ({"K_P": 0.1}, "the range of K_P 0.1 must be a pair of numbers"),
        ({}, "0 gains were given"),
        (("K_P", "K_Q", "K_R"), "no gain 'K_Q'"),  # three may be tried
        (("K_P", "K_Q", "K_R", "K_S"), "4 gains were given"),
    ],
)
def test_what_cannot_be_tried_is_refused(gains, message):
    with pytest.raises(ValueError, match=message):
        gb.safe_gains(fitted(0), RateLoop(), gains)


@pytest.mark.parametrize(
    ("fits", "parts", "message"),
    [
        ([], (0,), r"fits=\[\] and parts=\(0,\): give at least one of both"),
        (None, (), r"parts=\(\): give at least one of both"),
        (3, (0,), "a flight is 3: give the fit of a flight"),
    ],
)
def test_no_flight_is_refused(fits, parts, message):
    with pytest.raises((ValueError, TypeError), match=message):
        gb.safe_gains(fitted(0) if fits is None else fits, RateLoop(), ["K_P"], parts=parts)


@pytest.mark.parametrize("requirement", ["phase_margin", "gain_margin", "delay"])
@pytest.mark.parametrize("value", [-0.01, np.nan])
def test_requirements_below_zero_are_refused(requirement, value):
    """A negative delay would allow gains that the loop without it does not tolerate."""
    with pytest.raises(ValueError, match=f"required {requirement.replace('_', ' ')} is {value:g}"):
        gb.safe_gains(fitted(0), RateLoop(), {"K_P": (0.1, 1)}, **{requirement: value})


def test_files_of_gains_are_those_of_the_ground_stations(tmp_path):
    gb.experiment.write_gains({"ATC_RAT_PIT_P": 0.14}, tmp_path / "pitch.param")
    assert (tmp_path / "pitch.param").read_text(encoding="utf-8") == "ATC_RAT_PIT_P,0.14\n"
    # A line break in a reason must not become a parameter.
    reason = ["better in gusts\nATC_RAT_PIT_D,9"]
    gb.experiment.write_gains({"ATC_RAT_PIT_P": 0.14}, tmp_path / "why.param", reason)
    *above, gain = (tmp_path / "why.param").read_text(encoding="utf-8").splitlines()
    assert all(line.startswith("# ") for line in above)
    assert gain == "ATC_RAT_PIT_P,0.14"
    gb.experiment.write_gains({"MC_PITCHRATE_P": 0.14}, tmp_path / "pitch.params")
    lines = (tmp_path / "pitch.params").read_text(encoding="utf-8").splitlines()
    assert lines[-1].split("\t") == ["1", "1", "MC_PITCHRATE_P", "0.14", "9"]
    gb.experiment.write_gains({"p_pitch": 46.6, "d_pitch": 0.0}, tmp_path / "pitch.txt")
    lines = (tmp_path / "pitch.txt").read_text(encoding="utf-8").splitlines()
    assert lines == ["set p_pitch = 47", "set d_pitch = 0", "save"]
    with pytest.raises(ValueError, match="ATC_RAT_PIT_P is below 1"):
        gb.experiment.write_gains({"ATC_RAT_PIT_P": 0.14}, tmp_path / "other.txt")
