"""From a log to a measured response: what is chosen, said and refused, on made flights through 2 / (0.3 s + 1)."""

import re
from dataclasses import replace

import numpy as np
import pytest
from linear_simulation import lsim
from scipy.signal import chirp, lfilter

import greybox as gb
from greybox.data.record import Record, Recording
from greybox.workflows.identification.measurement import (
    FEEDBACK,
    Settings,
    found_tests,
    measure,
    named_signals,
)

PAIR = {"input": "u=IN.u", "output": "y=OUT.y"}
TIME = np.arange(0, 60, 0.04)
UNSTATED = (
    "hold of the input: not stated; if the input is held between its samples, delays are 20 ms too "
    "long."
)
INSIDE = (TIME >= 5) & (TIME < 55)
SWEEP = np.where(INSIDE, chirp(TIME - 5, 0.2, 50, 4, method="logarithmic", phi=-90), 0)


def flight(control, **more):
    y = lsim(([2], [0.3, 1]), control, TIME) + 1e-3 * np.random.default_rng(0).normal(
        size=TIME.size
    )
    records = {
        "IN": Record(TIME, {"u": control, "w": control}),
        "OUT": Record(TIME, {"y": y}),
    } | more
    return Recording(records, "made.bin", checksum="0123")


@pytest.fixture(scope="module")
def swept():
    return flight(SWEEP)


def truth(omega):
    return 2 / (0.3j * omega + 1)


def test_the_whole_of_an_open_loop_is_measured_directly(swept):
    found = measure(swept, Settings(**PAIR, whole=True, band=(2.0, 12.0), rate=20.0))
    response = found.response
    assert 1.9 < response.omega[0] < response.omega[-1] < 12.1
    assert np.abs(response.response / truth(response.omega) - 1).max() < 0.02
    about = dict(response.about)
    assert float(about.pop("spacing of the spectral lines, rad/s")) == pytest.approx(
        2 * np.pi / 60, 1e-5
    )
    assert about == {
        "log": "made.bin",
        "log sha256": "0123",
        "signals": "u = IN.u, y = OUT.y",
        "sampling": "20 Hz",
        "estimate": "spectral, direct",
        "band": "2 to 12 rad/s",
        "hold of the input not stated; sampling interval, s": "0.05",
        # Half a sample of 25 ms is 0.3 rad at 12 rad/s, over √2.
        "unstated hold": "3.8 to 21 % of the response, in its variance",
    }
    direct = "direct estimate; in a closed loop, give the injected signal for the joint estimate, instrument=..."
    assert found.choices == (
        f"open loop (the log shows no controller): {direct}",
        UNSTATED.replace("20 ms", "25 ms"),
    )
    assert (found.tests, found.used, found.controller) == ((), (), "")
    assert found.detail == str(replace(response, about={}))
    assert str(found) == "\n\n".join(["\n".join(found.choices), found.detail, str(found.quality)])
    assert repr(found).startswith("<Measurement <FrequencyResponse ")
    said = measure(swept, Settings(**PAIR, whole=True, open_loop=True, points=12))
    assert said.choices[0] == f"open loop, as stated: {direct}"
    same = gb.spectral.spectral_response(said.record, "u", "y", points=12)
    np.testing.assert_array_equal(said.response.omega, same.omega)


def test_sweeps_of_a_setpoint_are_found_and_are_the_instrument(swept):
    found = measure(swept, Settings(**PAIR, setpoint="IN.w", band=(2.0, 20.0)))
    assert [(test.kind, test.axis) for test in found.used] == [("sweep", "IN.w")]
    assert found.record.time[[0, -1]] == pytest.approx(
        [found.used[0].start, found.used[0].end], abs=0.05
    )
    assert found.signals == {"u": "IN.u", "y": "OUT.y", "instrument": "IN.w", "setpoint": "IN.w"}
    about = found.response.about
    low, high = found.used[0].band
    assert about["estimate"] == "spectral, joint input-output with IN.w"
    assert about["excitation"] == (
        f"1 sweep of IN.w, amplitude {found.used[0].amplitude:.3g}, {low:.4g} to {high:.4g} rad/s, "
        f"{found.used[0].start:.2f} to {found.used[0].end:.2f} s"
    )
    assert found.controller == "IN.w"
    assert found.choices == (
        "closed loop (IN.w is in the log): joint input-output estimate with the instrument IN.w. "
        f"{FEEDBACK}.",
        UNSTATED,
    )


def test_a_stated_instrument_and_units_are_said(swept):
    units = {
        "IN": Record(TIME, swept["IN"].signals, {"u": "deg"}),
        "OUT": Record(TIME, swept["OUT"].signals, {"y": "%"}),
    }
    found = measure(
        Recording(units, "made.bin"),
        Settings(**PAIR, instrument="IN.w", whole=True, band=(2.0, 12.0)),
    )
    assert found.signals == {"u": "IN.u", "y": "OUT.y", "instrument": "IN.w"}
    assert found.response.about["converted"] == "u from deg to rad, y from % to 1"
    assert found.choices[-2] == "converted: u from deg to rad, y from % to 1."
    assert found.choices[0].startswith(
        "open loop (the log shows no controller): joint input-output estimate with the instrument IN.w. In a loop"
    )
    expected = 0.01 * np.rad2deg(1) * truth(found.response.omega)
    assert np.median(np.abs(found.response.response / expected - 1)) < 0.02


@pytest.mark.parametrize("instrument", ["", "IN.w"])
def test_multisines_are_averaged_over_their_periods(instrument):
    omega = 2 * np.pi / 10 * np.arange(2, 20, 3)
    made = flight(sum(np.cos(w * TIME + w**2) for w in omega))
    found = measure(
        made, Settings(**PAIR, period=10.0, instrument=instrument, band=(omega[1], 9.0))
    )
    assert found.response.omega == pytest.approx(omega[1:5])
    assert np.abs(found.response.response / truth(omega[1:5]) - 1).max() < 0.05
    estimate = "periodic, joint input-output with IN.w" if instrument else "periodic, direct"
    assert found.response.about["estimate"] == estimate
    assert found.tests == ()
    assert found.choices == (
        "open loop (the log shows no controller): averages over whole periods: the more periods, the less bias by "
        "feedback.",
        UNSTATED,
    )


def test_system_identification_mode_says_what_was_injected():
    settings = {"Ax": 8, "FSt": 0.2, "FSp": 4.0, "TR": 49.0, "Mag": 0.1}
    run = {
        "SIDS": Record([5.0], {name: [value] for name, value in settings.items()}),
        "SIDD": Record(TIME, {"Targ": SWEEP}),
    }
    made = flight(SWEEP, **run)
    made = Recording({**made.records, "SIDD": made["SIDD"].between(5.0, 55.0)}, "made.bin")
    found = measure(made, Settings(**PAIR, band=(5.0, 10.0)))
    assert found.signals["instrument"] == "SIDD.Targ"
    assert "joint input-output estimate with the instrument SIDD.Targ. In a loop" in str(found)
    assert found.response.about["excitation"].startswith(
        "1 sweep of rate pitch, amplitude 0.1, 1.257 to 25.13 rad/s, 6.00 to 5"
    )
    without = {name: record for name, record in made.records.items() if name != "SIDD"}
    targets = Recording(
        {**without, "SIDD": Record(made["SIDD"].time, {"Other": made["SIDD"]["Targ"]})}, "made.bin"
    )
    assert measure(targets, Settings(**PAIR, band=(5.0, 10.0))).signals == {
        "u": "IN.u",
        "y": "OUT.y",
    }


def test_tests_of_several_axes_are_refused_until_one_is_chosen():
    made = flight(SWEEP, ATT=Record(TIME, {"DesRoll": SWEEP, "DesPitch": np.roll(SWEEP, 20)}))
    axes = (
        r"several axes \(ATT\.DesRoll, ATT\.DesPitch\): choose one, such as axis='ATT\.DesRoll'\."
    )
    with pytest.raises(ValueError, match=axes):
        measure(made, Settings(**PAIR))
    found = measure(made, Settings(**PAIR, axis="ATT.DesPitch", band=(5.0, 10.0)))
    assert [test.axis for test in found.used] == ["ATT.DesPitch"]
    assert found.signals["instrument"] == "ATT.DesPitch"


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        (
            {},
            "no test was found: give setpoint=..., announced=... or instrument=..., or whole=True for the whole log.",
        ),
        ({"setpoint": "IN.w", "tests": "2"}, "tests='2' must lie between 1 and 1"),
        ({"setpoint": "IN.w", "tests": "0"}, "tests='0' must lie between 1 and 1"),
        ({"setpoint": "IN.w", "axis": "yaw"}, "no test has the axis 'yaw'; there are IN.w."),
        (
            {"setpoint": "IN.w", "tests": "1,1-1", "axis": "yaw"},
            "no test has the axis 'yaw'; there are IN.w.",
        ),
    ],
)
def test_what_is_not_there_is_told(swept, wanted, said):
    with pytest.raises(ValueError, match=re.escape(said)):
        measure(swept, Settings(**PAIR, **wanted))


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"settle": 0.0, "points": 2}, ""),
        ({"period": 0.0}, "period=0 must be a number of seconds above 0: leave it out"),
        ({"settle": -1e-9}, "settle=-1e-09 must be a number of seconds of at least 0."),
        ({"period": float("inf")}, "period=inf must be a number of seconds above 0"),
        ({"points": 10_000, "band": (1e-9, 2e-9)}, ""),
        ({"points": 10_001}, "points=10001 must lie between 2 and 10000."),
        ({"points": 1}, "points=1 must lie between 2 and 10000."),
        ({"band": (0.0, 1.0)}, ""),
        ({"band": (-1.0, 1.0)}, "band=-1 1 must be two frequencies of at least 0 rad/s, the lower"),
        ({"band": (1.0, 1.0)}, "band=1 1 must be two frequencies of at least 0 rad/s, the lower"),
        ({"band": (1.0, float("inf"))}, "band=1 inf must be two frequencies of at least 0 rad/s"),
        ({"open_loop": True}, ""),
        (
            {"open_loop": True, "instrument": "IN.w"},
            "open_loop=True asks for the direct estimate, instrument=... for",
        ),
        (
            {"output": "y=IN.u"},
            "input=u=IN.u and output=y=IN.u are the same signal or have the same name.",
        ),
        (
            {"output": "IN.u"},
            "input=u=IN.u and output=IN.u are the same signal or have the same name.",
        ),
        (
            {"output": "u=OUT.y"},
            "input=u=IN.u and output=u=OUT.y are the same signal or have the same name.",
        ),
        (
            {"output": "setpoint=OUT.y"},
            "the name 'setpoint' is reserved: give the signal another name, NAME=SIGNAL.",
        ),
    ],
)
def test_settings_that_make_no_sense_in_any_log_are_refused(stated, said):
    if not said:
        assert Settings(**(PAIR | stated)).names == (("u", "IN.u"), ("y", "OUT.y"))
        return
    with pytest.raises(ValueError, match=re.escape(said)):
        Settings(**(PAIR | stated))


def test_sines_are_measured_one_by_one():
    """Two of them in the band; a fourth one of amplitude zero is named and not used."""
    sines = [(1.5, 2.0, 16, 0.2), (5.0, 18.5, 3, 0.0), (3.0, 22.0, 16, 0.2), (6.0, 42.0, 16, 0.2)]
    control, records = np.zeros(TIME.size), []
    for k, (w, start, lasts, size) in enumerate(sines):
        during = (TIME - start >= 0) & (TIME - start < lasts)
        control[during] = size * np.sin(w * (TIME[during] - start))
        records.append(np.column_stack([TIME[during], np.full((during.sum(), 4), [k, 1, w, size])]))
    rows = np.vstack(records)[::5]
    announced = Record(
        rows[:, 0], dict(zip(("Seg", "Ax", "W", "Eta"), rows[:, 1:].T, strict=True)), {"Eta": "deg"}
    )
    made = flight(control, SINE=announced)
    found = measure(
        made, Settings(**PAIR, announced="SINE", band=(2.0, 8.0), tests="1-4", settle=4.0)
    )
    assert found.response.omega == pytest.approx([3.0, 6.0], rel=1e-3)
    assert np.abs(found.response.response / truth(found.response.omega) - 1).max() < 0.02
    assert [len(found.tests), len(found.used)] == [4, 2]
    assert "the sine from 18.5 s is not usable: barely excited" in str(found.quality)
    assert found.response.about["estimate"] == "single sines"
    assert (
        found.response.about["excitation"]
        == "2 sines of 1, amplitude 0.2 deg, 3 to 6 rad/s, 22.00 to 57.80 s"
    )
    assert found.choices == (
        "open loop (the log shows no controller): amplitudes at the frequency of the excitation, whose ratio "
        "feedback does not bias.",
        UNSTATED,
    )
    with pytest.raises(
        ValueError,
        match=r"no sine lies in the band from 7 to 8 rad/s; there are 1\.5, 3, 6 rad/s\.",
    ):
        measure(made, Settings(**PAIR, announced="SINE", band=(7.0, 8.0)))


def test_frequencies_with_warnings_are_left_out_on_request():
    """The control of one sine is clipped, and has harmonics."""
    starts, omega = (2.0, 22.0, 42.0), (1.5, 3.0, 6.0)
    control = np.zeros(TIME.size)
    for w, start in zip(omega, starts, strict=True):
        during = (start <= TIME) & (start + 16 > TIME)
        control[during] = 0.2 * np.sin(w * (TIME[during] - start))
    clipped = (starts[1] <= TIME) & (starts[1] + 16 > TIME)
    control[clipped] = np.clip(control[clipped], -0.08, 0.08)
    made = flight(control)
    every, clean = (
        measure(made, Settings(**PAIR, setpoint="IN.w", drop_warned=drop)) for drop in (False, True)
    )
    assert len(every.response) == 3
    assert clean.response.omega == pytest.approx([1.5, 6.0], rel=1e-2)
    assert any(text.startswith("left out: 1 point of 3 at ") for text in clean.choices)


def test_frequencies_between_two_parts_of_a_sweep_are_beyond_it():
    """The log has a gap while the sweep runs from 5 to 12 rad/s."""
    made = flight(SWEEP)
    gap = (TIME > 27) & (TIME < 43)
    records = {
        key: Record(TIME[~gap], {name: x[~gap] for name, x in record.signals.items()})
        for key, record in made.items()
    }
    found = measure(Recording(records, "made.bin"), Settings(**PAIR, setpoint="IN.w"))
    (beyond,) = [f.omega for f in found.quality.findings if f.about == "band"]
    inside = [w for w in found.response.omega if 6 < w < 10]
    assert inside
    assert set(inside) <= set(beyond)


def test_what_cannot_be_estimated_is_refused_with_the_reason():
    found = measure(flight(SWEEP), Settings(**PAIR, whole=True, band=(200.0, 300.0)))
    assert found.response is None
    assert not found.quality.usable
    assert found.quality.findings[0].about == "response"
    assert isinstance(
        gb.identify(flight(SWEEP), **PAIR, whole=True, band=(200.0, 300.0)).fit, type(None)
    )


def test_signals_that_share_a_name_are_told():
    assert named_signals(["u=RATE.POut", "ATT.Pitch"]) == {"u": "RATE.POut", "Pitch": "ATT.Pitch"}
    with pytest.raises(
        ValueError, match="two signals have the same name: give them names of your own, NAME=SIGNAL"
    ):
        named_signals(["ANG.Pitch", "ATT.Pitch"])


def test_fields_of_an_announcement_can_have_other_names():
    """The frequency of each test in Hz, as a message of one's own has it; none are fields that are looked for."""
    ticks = np.arange(0, 40, 0.1)
    speed = np.where(ticks < 20, 0.5, 1.5)
    log = flight(SWEEP, TEST=Record(ticks, {"speed": speed, "W": np.full(ticks.size, 7.0)}))
    own = found_tests(log, Settings(**PAIR, announced="TEST", fields={"frequency": "speed"}))
    assert [test.omega for test in own] == pytest.approx([np.pi, 3 * np.pi])
    assert [test.omega for test in found_tests(log, Settings(**PAIR, announced="TEST"))] == [7.0]


def test_an_input_that_moves_along_is_conditioned_on():
    other = 0.6 * SWEEP + np.random.default_rng(1).normal(size=TIME.size)
    y = lsim(([2], [0.3, 1]), SWEEP, TIME) + lsim(([3], [0.5, 1]), other, TIME)
    log = Recording({"T": Record(TIME, {"u": SWEEP, "w": other, "y": y})}, "made")
    pair = {"input": "u", "output": "y", "whole": True}
    alone, conditioned = (measure(log, Settings(**pair, conditioned=c)) for c in ((), ("w",)))
    wrong, right = (
        np.median(np.abs(m.response.response / truth(m.response.omega) - 1))
        for m in (alone, conditioned)
    )
    assert right < 0.02
    assert wrong > 0.2
    assert "effect of w is removed" in conditioned.choices[1]
    for options in ({"conditioned": ("u",)}, {"conditioned": ("w",), "period": 5.0}):
        with pytest.raises(ValueError, match=r"same signal|for sweeps and noise"):
            Settings(**pair | options)


def test_a_yaw_rate_called_r_is_no_setpoint():
    log = Recording({"T": Record(TIME, {"dr": SWEEP, "r": 3 * SWEEP})}, "made")
    found = measure(log, Settings("dr", "r", whole=True))
    assert not found.used
    assert "direct" in found.response.about["estimate"]


def test_a_multisine_without_its_period_is_told_from_a_bad_instrument():
    """The cure works as it is written."""
    random = np.random.default_rng(0)
    time = np.arange(6000) / 100
    lines = np.unique(np.rint(np.geomspace(1, 40, 12))) / 10  # Hz
    r = np.sin(2 * np.pi * time[:, None] * lines + random.uniform(0, 6, lines.size)).sum(axis=1)
    u = r + 0.05 * random.normal(size=time.size)
    y = lfilter([0.1], [1, -0.9], u) + 0.02 * random.normal(size=time.size)
    record = gb.Record(time, {"u": u, "y": y, "r": r}, hold={"u": 0.0, "r": 0.0})
    settings = Settings("log.u", "log.y", instrument="log.r")
    log = Recording({"log": record}, "log.csv")

    refused = measure(log, settings)
    (text,) = refused.quality.refusals
    assert "repeats itself every 10 s" in text
    assert "period=10." in text
    measured = measure(log, replace(settings, period=10.0))
    exact = 0.1 / (1 - 0.9 * np.exp(-1j * measured.response.omega / 100))
    assert np.median(np.abs(measured.response.response / exact - 1)) < 0.02
