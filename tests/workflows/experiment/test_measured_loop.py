"""Margins of measured loops, against loops that are known."""

from dataclasses import replace

import numpy as np
import pytest

import greybox as gb
from greybox.data.record import Recording
from greybox.models.ardupilot import AngleController, RateController
from greybox.models.firmware import disagreements, from_log, loop_of_log
from greybox.models.rate import DampedAngle
from greybox.workflows.experiment import broken_loop
from greybox.workflows.experiment.sampled_loop import sampled_loop

RATE = 100.0
PLANT = {"K_phi": 90.0, "a": 0.7, "T_rotor": 0.05, "T_delay": 0.004}
SIGNALS = {"q": "theta_dot"}


def integrator(low, high, points=60, gain=2.0, delay=0.2):
    omega = np.geomspace(low, high, points)
    response = gain * np.exp(-1j * omega * delay) / (1j * omega)
    return gb.FrequencyResponse(omega, response, "u", "y", variance=1e-8 * np.abs(response) ** 2)


def test_margins_are_read_between_the_measured_points():
    answer = gb.margins(integrator(0.1, 30))
    assert answer["crossover"].value == pytest.approx(2, rel=1e-4)
    assert answer["phase margin"].value == pytest.approx(90 - np.degrees(0.4), abs=0.02)
    assert answer["gain margin"].omega == pytest.approx(np.pi / 0.4, rel=1e-3)
    assert answer["gain margin"].value == pytest.approx(20 * np.log10(np.pi / 0.8), abs=0.02)
    assert answer["delay margin"].value == pytest.approx(np.pi / 4 - 0.2, rel=1e-3)
    assert answer["phase margin"].low < answer["phase margin"].value < answer["phase margin"].high


def test_an_error_that_all_points_share_moves_the_gain_of_the_whole_loop():
    """The gain margin then has the error of the gain alone, in closed form: 8 % of it."""
    loop = integrator(0.1, 30)
    shared = 0.08 * loop.response[None]
    total = loop.variance + np.abs(shared[0]) ** 2
    answer = gb.margins(replace(loop, variance=total, common_errors=shared))["gain margin"]
    expected = 20 * np.log10(np.pi / 0.8 / (1 + 0.08 * np.array([1.96, -1.96])))
    assert (answer.low, answer.high) == pytest.approx(expected, abs=0.2)


@pytest.mark.parametrize(("points", "factor"), [(2, "300"), (5, "4.2"), (20, "")])
def test_margins_between_distant_points_are_marked(points, factor):
    notes = " ".join(gb.margins(integrator(0.1, 30, points)).notes)
    assert ("Neighboring points differ" in notes) == bool(factor)
    assert f"factor of {factor}" in notes or not factor


@pytest.mark.parametrize(
    ("band", "missing"), [((0.1, 1.5), "phase margin"), ((3, 30), "crossover")]
)
def test_nothing_is_extrapolated(band, missing):
    answer = gb.margins(integrator(*band))
    assert np.isnan(answer["phase margin"].value)
    (note,) = answer.notes
    assert missing in note
    assert "nothing is extrapolated" in note
    assert "has an unmeasured phase margin" in answer.verdict


def test_several_crossovers_are_said():
    loop = integrator(0.1, 30)
    bump = 1 + 3 * np.exp(-((np.log(loop.omega / 5) / 0.2) ** 2))
    answer = gb.margins(loop.times(bump + 0j))
    assert any("several frequencies" in note for note in answer.notes)
    assert answer["phase margin 3"].omega > answer["phase margin 1"].omega


def test_an_open_loop_is_refused():
    omega = np.geomspace(1, 10, 20)
    noise = 0.01 * np.random.default_rng(0).normal(size=20)
    with pytest.raises(ValueError, match="the loop was open"):
        broken_loop(gb.FrequencyResponse(omega, 1 + noise, "d", "u", variance=np.full(20, 1e-4)))
    with pytest.raises(ValueError, match="the loop was open"):
        broken_loop(
            gb.FrequencyResponse(omega, 1 + 1e-9 * noise, "d", "u", variance=np.full(20, 1e-30))
        )


def test_a_response_without_errors_has_the_same_margins_without_intervals():
    loop = integrator(0.1, 30)
    exact, measured = gb.margins(replace(loop, variance=None)), gb.margins(loop)
    for name in ("phase margin", "gain margin", "crossover"):
        assert exact[name].value == measured[name].value
        assert np.isnan([exact[name].low, exact[name].high]).all()
    # Noise makes the least distance smaller, which only draws can show.
    assert exact["modulus margin"].value == pytest.approx(
        measured["modulus margin"].value, rel=0.01
    )
    assert exact.is_safe
    assert any("no variance" in note for note in exact.notes)


def test_a_measured_loop_stands_alone_and_a_model_needs_a_controller():
    with pytest.raises(TypeError, match="give no argument but the level"):
        gb.margins(integrator(0.1, 30), controllers())
    with pytest.raises(TypeError, match="give its controller"):
        gb.margins(DampedAngle())
    with pytest.raises(TypeError, match="give a Fit, a model"):
        gb.margins("pitch", controllers())
    with pytest.raises(ValueError, match="cannot be evaluated elsewhere"):
        gb.margins(integrator(0.1, 30)).require_loop()
    with pytest.raises(ValueError, match=r"give rate=\.\.\. in Hz"):
        sampled_loop(DampedAngle(), np.ones((1, 4)), [])


def controllers():
    values = {"FLTT": 0.0, "FLTD": 0.0, "D": 0.002}
    angle = AngleController({"acceleration": 0.0, "delay": 0}, rate=RATE)
    return [angle, RateController(values, rate=RATE, signals=SIGNALS)]


@pytest.fixture(scope="module")
def recording():
    """A sweep into the mixer, by the names and the units of a log of ArduPilot."""
    sweep = gb.experiment.sweep(1.5, 40.0, 30, RATE, amplitude=0.05, signal="mixer")
    noise = {"theta_dot": 0.05, "theta": 0.003}
    flown = gb.virtual_flight(DampedAngle(), PLANT, sweep, controller=controllers(), noise=noise)
    rate = {
        "P": np.degrees(flown["theta_dot"]),
        "PDes": np.degrees(flown["q_reference"]),
        "POut": flown["u"],
        "Pitch": flown["theta"],
    }
    parameters = {f"ATC_RAT_PIT_{n}": v for n, v in controllers()[1].values.items() if n.isupper()}
    parameters |= {"ATC_ANG_PIT_P": 4.5, "SCHED_LOOP_RATE": RATE}
    records = {
        "RATE": gb.Record(flown.time, rate, {"P": "deg/s", "PDes": "deg/s"}),
        "SIDD": gb.Record(flown.time, {"Targ": flown["mixer"]}),
        "SIDS": gb.Record([0.0, 0.5], {"Ax": [11.0, 11.0]}),
    }
    return Recording(records, "a.BIN", "", {"parameters": parameters, "vehicle": "ArduCopter"})


@pytest.fixture(scope="module")
def answer(recording):
    rate = recording["RATE"]
    columns = {"u": rate["POut"], "theta": rate["Pitch"], "d": recording["SIDD"]["Targ"]}
    record = gb.Record(rate.time, columns)
    data = gb.spectral.spectral_response(record, "u", "theta", instrument="d", points=20)
    problem = gb.Problem(DampedAngle(), data, gb.MaximumLikelihood())
    fit = gb.fit(problem, starts=[PLANT], profiles=False, progress=False)
    return loop_of_log(recording, fit)


def test_model_and_measurements_agree_with_the_truth(recording, answer):
    row = np.array([[PLANT[name] for name in DampedAngle.parameters]])
    truth = gb.margins(DampedAngle(), controllers(), PLANT)
    loop = sampled_loop(DampedAngle(), row, controllers())
    assert answer.check.residual < 1e-3
    assert len(answer.measured) == 2
    for measured in answer.measured:
        for name in ("phase margin", "crossover", "delay margin"):
            margin = measured[name]
            slack = 0.5 * (margin.high - margin.low)
            assert margin.low - slack < truth[name].value < margin.high + slack, name
    assert answer.notes == ()
    assert answer.is_safe
    assert "of the model" in str(answer)
    injected = broken_loop(answer.flown.sensitivity(recording, answer.check))
    exact = loop.broken_at("u", injected.omega)[0]
    assert 0.3 < np.mean(np.abs(injected.response - exact) ** 2 / injected.variance) < 3
    assert answer.to_dict()["control_residual"] == answer.check.residual


def test_a_model_of_another_plant_disagrees(answer):
    other = gb.margins(DampedAngle(), controllers(), {**PLANT, "K_phi": 60.0})
    notes = disagreements(other, answer.measured)
    assert any("disagree on the crossover" in note for note in notes)
    unstable = gb.margins(DampedAngle(), controllers(), {**PLANT, "T_delay": 0.3})
    (note,) = disagreements(unstable, answer.measured)
    assert "the loop with the model is unstable" in note


def test_gains_that_did_not_fly_are_refused(recording):
    parameters = recording.metadata["parameters"] | {"ATC_RAT_PIT_P": 0.5}
    wrong = replace(recording, metadata={**recording.metadata, "parameters": parameters})
    with pytest.raises(ValueError, match="does not reproduce"):
        from_log(wrong, "pitch").check(wrong)
