"""Excited segments: from System Identification mode, from a message, and from the setpoint alone."""

import math

import numpy as np
import pytest
from sine_schedules import schedule

from greybox.data.excited_segment import segment_table
from greybox.data.logs.segment_detection import announcing, find_segments
from greybox.data.record import Record, Recording

# --- System Identification mode


def system_identification(last=91.0, texts=(), **changes):
    setting = {
        "Ax": 11,
        "Mag": 0.06,
        "FSt": 0.1,
        "FSp": 6.0,
        "TFin": 5.0,
        "TC": 20.0,
        "TR": 60.0,
        "TFout": 5.0,
    }
    sids = Record([100.0], {name: [value] for name, value in (setting | changes).items()})
    time = np.arange(100.0, 100.0 + last, 0.01)
    return Recording(
        {"SIDS": sids, "SIDD": Record(time, {"Targ": 0 * time})}, metadata={"texts": texts}
    )


def test_a_system_identification_run():
    (run,) = find_segments(system_identification())
    assert (run.kind, run.axis, run.amplitude, run.usable) == ("sweep", "mixer pitch", 0.06, True)
    assert (run.start, run.end) == (101.0, 161.0)
    assert run.band == pytest.approx((0.2 * math.pi, 12 * math.pi))
    assert "0.628 to 37.7" in segment_table([run])


def test_a_run_at_one_frequency_is_a_sine_and_unknown_axes_are_numbers():
    (run,) = find_segments(system_identification(FSp=0.1, Ax=77))
    assert (run.kind, run.axis) == ("sine", "77")
    assert run.omega == pytest.approx(0.2 * math.pi)


def test_aborted_runs():
    (run,) = find_segments(system_identification(last=31.0))
    assert not run.usable
    assert run.end == pytest.approx(131, abs=0.02)
    assert run.findings == ("ended early, after 30.0 of 60.0 s",)
    (run,) = find_segments(
        system_identification(texts=((99.0, "SystemID Stopped"), (111.0, "SystemID Stopped: lean")))
    )
    assert run.findings[0] == "ended early, after 10.0 of 60.0 s (SystemID Stopped: lean)"
    (run,) = find_segments(system_identification(last=0.5))
    assert run.findings[0] == "ended before the waveform began"
    assert not run.usable


@pytest.mark.parametrize(
    "changes", [{"TR": math.nan}, {"FSt": 0.0}, {"FSp": -1.0}, {"Ax": math.inf}]
)
def test_runs_without_sense_are_no_segments(changes):
    assert find_segments(system_identification(**changes)) == ()


# --- announced tests

PLAN = [(20.0, 15.0), (8.0, 15.0), (4.0, 16.0), (2.0, 32.0)]  # rad/s, s


def announced(plan=PLAN, modes=(), **columns):
    time, omega, number, now = [], [], [], 5.0
    for k, (w, duration) in enumerate(plan, start=1):
        t = np.arange(now, now + duration, 0.0123)
        time, omega, number = [*time, *t], [*omega, *([w] * t.size)], [*number, *([k] * t.size)]
        now += duration + 2.0
    fields = {
        "Seg": number,
        "Ax": np.full(len(time), 2.0),
        "W": omega,
        "Eta": np.full(len(time), 3.0),
    }
    record = Record(time, fields | columns, units={"Eta": "deg"})
    return Recording({"SINE": record}, source="flight.BIN", metadata={"modes": modes})


def test_announced_sines():
    found = find_segments(announced(), message="SINE")
    assert [s.omega for s in found] == [20, 8, 4, 2]
    assert [round(s.duration) for s in found] == [15, 15, 16, 32]
    assert {(s.axis, s.amplitude, s.unit, s.source, s.usable) for s in found} == {
        ("2", 3.0, "deg", "SINE", True)
    }
    assert math.isnan(found[0].offset)
    assert "3 deg" in segment_table(found)
    named = find_segments(announced(), message="SINE", fields={"omega": "W", "axis": "Ax"})
    assert [s.omega for s in named] == [20, 8, 4, 2]
    hertz = find_segments(announced(), message="SINE", fields={"frequency": "W"})
    assert hertz[0].omega == pytest.approx(40 * math.pi)


def test_a_record_announces_by_its_own_signals():
    found = find_segments(announced()["SINE"], fields={"omega": "W"})
    assert [s.omega for s in found] == [20, 8, 4, 2]


def test_the_same_frequency_twice_is_two_tests():
    found = find_segments(
        announced([(5.0, 10.0), (5.0, 10.0)]), message="SINE", fields={"omega": "W"}
    )
    assert len(found) == 2


def test_a_single_message_of_another_frequency_is_no_test():
    omega = announced()["SINE"]["W"].copy()
    omega[0] = 30.0
    found = find_segments(announced(W=omega), message="SINE")
    assert [s.omega for s in found] == [20, 8, 4, 2]


def test_useless_tests_are_listed_with_the_reason():
    found = find_segments(announced([*PLAN, (4.0, 2.0), (0.05, 20.0)]), message="SINE")
    assert [s.usable for s in found] == [True] * 4 + [False] * 2
    assert "ended early, after 1.3 periods where others have about" in found[4].findings[0]
    assert found[5].findings[0] == "shorter than one period (0.16 of one)"
    assert "5: ended early" in segment_table(found)
    flight = announced()
    weak = np.where(
        flight["SINE"]["Seg"] == 2, 0.0, np.where(flight["SINE"]["Seg"] == 3, 0.01, 3.0)
    )
    found = find_segments(announced(Eta=weak), message="SINE")
    assert [s.usable for s in found] == [True, False, False, True]
    assert found[1].findings == ("barely excited: the amplitude is 0",)
    assert found[2].findings == ("barely excited: amplitude 0.01 where others reach 3",)


def test_a_change_of_mode_during_a_test():
    found = find_segments(announced(modes=((0.0, "GUIDED"), (25.0, "LOITER"))), message="SINE")
    assert [s.usable for s in found] == [True, False, True, True]
    assert found[1].findings == ("the mode changed to LOITER at 25.0 s, during the test",)


def test_what_cannot_be_found_is_said():
    with pytest.raises(KeyError, match=r"flight.BIN has no message 'TEST'; it has SINE"):
        find_segments(announced(), message="TEST")
    with pytest.raises(KeyError, match="no signal 'F'"):
        find_segments(announced(), message="SINE", fields={"omega": "F"})
    with pytest.raises(ValueError, match="name omega or frequency"):
        find_segments(announced(), message="SINE", fields={"axis": "Ax"})
    with pytest.raises(ValueError, match="are omega, speed"):
        find_segments(announced(), message="SINE", fields={"omega": "W", "speed": "W"})
    with pytest.raises(KeyError, match="ATT"):
        find_segments(announced(), setpoint="ATT.DesPitch")
    assert find_segments(announced()) == ()
    assert segment_table(()) == "no excited segment was found"


# --- the setpoint alone


def test_setpoints_of_a_recording():
    t, r, starts = schedule([(8.0, 10.0), (4.0, 15.0)])
    attitude = Record(t, {"DesRoll": 0 * t, "DesPitch": r}, units={"DesPitch": "deg"})
    for words in ({}, {"setpoint": "ATT.DesPitch"}, {"setpoint": ["ATT.DesPitch"]}):
        found = find_segments(Recording({"ATT": attitude}), **words)
        assert [round(s.omega, 2) for s in found] == [8, 4]
        assert {(s.axis, s.unit, s.source) for s in found} == {
            ("ATT.DesPitch", "deg", "setpoint ATT.DesPitch")
        }
    prepared = Record(t, {"r": np.where(t < starts[0][1] - 3, np.nan, r)})
    assert [round(s.omega, 2) for s in find_segments(prepared)] == [8, 4]
    assert [round(s.omega, 2) for s in find_segments(prepared, setpoint="r")] == [8, 4]
    gap = (t < starts[1][0] + 5) | (t > starts[1][0] + 8)
    assert len(find_segments(Record(t[gap], {"r": r[gap]}))) == 3


def test_a_heading_is_unwrapped_before_it_is_searched():
    """Sines of 5° about north, where the heading jumps between 0 and 360°."""
    time, setpoint = np.arange(0, 100, 0.02), np.zeros(5000)
    for start, omega in ((10, 4.0), (50, 2.0)):
        rows = (time >= start) & (time < start + 30)
        setpoint[rows] = 5 * np.sin(omega * (time[rows] - start))
    log = Recording({"ATT": Record(time, {"DesYaw": setpoint % 360}, {"DesYaw": "degheading"})})
    assert [s.omega for s in find_segments(log) if s.usable] == pytest.approx([4.0, 2.0], rel=0.01)


def test_messages_that_announce_tests_are_named():
    time = np.arange(0, 10, 0.1)
    sine = Record(time, dict.fromkeys(("Seg", "Ax", "W", "Eta"), np.ones(100)))
    log = Recording({"ATT": Record(time, {"Pitch": time}), "SINE": sine})
    assert announcing(log) == ("SINE",)


def flown_by(stick):
    """A sine in the setpoint of the roll angle, and the stick of the pilot."""
    time = np.arange(0, 40, 0.02)
    setpoint = np.where((time > 5) & (time < 35), 5 * np.sin(2 * time), 0)
    rcin = Record(
        time[::2],
        {
            "C1": 1500 + stick * setpoint[::2] + np.round(np.sin(9 * time[::2])),
            "C2": 1500 + 0 * time[::2],
        },
    )
    return Recording({"ATT": Record(time, {"DesRoll": setpoint, "Roll": setpoint}), "RCIN": rcin})


def test_a_sine_of_the_stick_is_no_usable_sine():
    (flown,) = find_segments(flown_by(stick=20.0))
    assert not flown.usable
    assert "flown by hand: the stick RCIN.C1 moves with it" in flown.findings[0]
    (commanded,) = find_segments(flown_by(stick=0.0))
    assert commanded.usable


def test_lost_samples_and_slow_logging_before_do_not_hide_a_sine():
    """Fifty gaps of five samples, and a tenth of the rate until the test; a gap of two seconds ends it."""
    time = np.arange(0, 80, 0.01)
    kept = (time > 20) | (np.arange(time.size) % 10 == 0)
    for start in np.random.default_rng(0).choice(np.arange(2600, 7400), 50):
        kept[start : start + 5] = False
    setpoint = np.where((time > 25) & (time < 75), np.sin(3 * (time - 25)), 0)
    (found,) = find_segments(Record(time[kept], {"r": setpoint[kept]}))
    assert (found.start, found.end) == pytest.approx((25, 75), abs=1.1)
    assert found.omega == pytest.approx(3, rel=1e-3)
    kept &= (time < 49) | (time > 51)
    assert len(find_segments(Record(time[kept], {"r": setpoint[kept]}))) == 2


@pytest.mark.parametrize(
    ("short", "usable"),
    [
        ((2.0, 16.0 * 0.74), False),  # 3.8 of 10 periods, and 0.74 of the median duration
        ((2.0, 16.0 * 0.76), True),
        ((20.0, 2.0), True),  # periods of high frequency take less time
    ],
)
def test_a_test_ended_early_with_less_periods_and_less_time_than_others(short, usable):
    """Others have 10 periods in 16 s; early is less than half of the one and less than three quarters of the other."""
    omega = 2 * np.pi * 10 / 16
    found = find_segments(
        announced([(omega, 16.0), (omega, 16.0), (omega, 16.0), short]), message="SINE"
    )
    assert [s.usable for s in found] == [True] * 3 + [usable]


@pytest.mark.parametrize(("share", "usable"), [(0.48, False), (0.52, True)])
def test_half_of_the_periods_of_others_are_enough(share, usable):
    omega = 2 * np.pi * 10 / 16
    found = find_segments(
        announced([(omega, 16.0)] * 3 + [(omega * share * 16 / 8, 8.0)]), message="SINE"
    )
    assert found[-1].usable is usable


@pytest.mark.parametrize(("weak", "usable"), [(0.029, False), (0.031, True)])
def test_a_hundredth_of_the_largest_amplitude_is_an_excitation(weak, usable):
    flight = announced()
    found = find_segments(
        announced(Eta=np.where(flight["SINE"]["Seg"] == 3, weak, 3.0)), message="SINE"
    )
    assert [s.usable for s in found] == [True, True, usable, True]


@pytest.mark.parametrize(("pause", "tests"), [(0.95, 1), (1.05, 2)])
def test_a_second_without_its_announcement_ends_a_test(pause, tests):
    time = np.concatenate([np.arange(0, 10, 0.02), np.arange(9.98 + pause, 20, 0.02)])
    record = Record(time, {"W": np.full(time.size, 5.0)})
    found = find_segments(record, fields={"omega": "W"})
    assert (len(found), found[0].start, found[-1].end) == (tests, time[0], time[-1])
    slow = np.concatenate(
        [np.arange(0, 30, 0.5), np.arange(29.5 + 2.5 * pause, 60, 0.5)]
    )  # five of its intervals
    record = Record(slow, {"W": np.full(slow.size, 5.0)})
    assert len(find_segments(record, fields={"omega": "W"})) == tests


@pytest.mark.parametrize(
    ("moment", "usable"), [(22.05, True), (22.15, False), (36.95, True), (36.85, False)]
)
def test_a_mode_that_changes_within_a_tenth_of_a_second_of_an_end_is_outside(moment, usable):
    """The second test lasts from 22 to 37 s."""
    found = find_segments(announced(modes=((moment, "LOITER"),)), message="SINE")
    assert (round(found[1].start, 1), round(found[1].end, 1)) == (22.0, 37.0)
    assert [s.usable for s in found] == [True, usable, True, True]


@pytest.mark.parametrize(("travel", "usable"), [(48.0, True), (52.0, False)])
def test_a_stick_that_moves_by_a_twentieth_of_its_travel_flies(travel, usable):
    """Of 1000 µs, peak to peak."""
    time = np.arange(0, 40, 0.02)
    sine = np.where((time > 5) & (time < 35), np.sin(2 * time), 0)
    records = {
        "ATT": Record(time, {"DesRoll": 5 * sine}),
        "RCIN": Record(time, {"C1": 1500 + travel / 2 * sine}),
    }
    (found,) = find_segments(Recording(records))
    assert found.usable is usable


@pytest.mark.parametrize(("periods", "usable"), [(0.97, False), (1.03, True)])
def test_a_test_has_one_period_at_least(periods, usable):
    (found,) = find_segments(announced([(2 * np.pi * periods / 10, 10.0)]), message="SINE")
    assert found.usable is usable


def test_a_stick_that_moves_before_and_after_a_test_does_not_fly_it():
    time = np.arange(0, 40, 0.02)
    sine = np.where((time > 10) & (time < 30), np.sin(2 * time), 0)
    stick = 1500 + 200 * np.sign(np.sin(1.3 * time)) * ((time < 7) | (time > 33))
    records = {"ATT": Record(time, {"DesRoll": 5 * sine}), "RCIN": Record(time, {"C1": stick})}
    (found,) = find_segments(Recording(records))
    assert found.usable


@pytest.mark.parametrize("others", [1, 2])
def test_two_other_sines_are_enough_to_compare_with(others):
    omega = 2 * np.pi * 10 / 16
    found = find_segments(announced([(omega, 16.0)] * others + [(omega, 5.0)]), message="SINE")
    assert found[-1].usable is (others == 1)


@pytest.mark.parametrize(("lost", "pieces"), [(1, 1), (2, 2)])
def test_one_lost_sample_of_a_slow_log_is_no_pause(lost, pieces):
    """Samples of 1.2 s, in a sine of half a minute a period: from two and a half intervals on it is a gap."""
    time = np.arange(0, 360, 1.2)
    kept = ~((time > 179) & (time < 179 + 1.2 * (lost + 0.5)))
    record = Record(
        time[kept], {"r": np.where((time > 30) & (time < 330), np.sin(0.2 * time), 0)[kept]}
    )
    found = [s for s in find_segments(record) if s.kind == "sine"]
    assert len(found) == pieces


@pytest.mark.parametrize(
    ("setpoint", "stick", "others"),
    [
        ("ATT.DesRoll", "RCIN.C1", ("RCIN.C2", "RCIN.C3", "RCIN.C4")),
        ("ATT.DesPitch", "RCIN.C2", ("RCIN.C1", "RCIN.C3", "RCIN.C4")),
        ("ATT.DesYaw", "RCIN.C4", ("RCIN.C1", "RCIN.C2", "RCIN.C3", "RCIN.C5")),
        *(
            (f"vehicle_attitude_setpoint.{axis}", f"manual_control_setpoint.{stick}", others)
            for axis, letter, rest in (
                ("roll", "y", "xrz"),
                ("pitch", "x", "yrz"),
                ("yaw", "r", "xyz"),
            )
            for stick, others in (
                (axis, ("manual_control_setpoint.throttle",)),
                (letter, tuple(f"manual_control_setpoint.{other}" for other in rest)),
            )
        ),
    ],
)
def test_the_stick_of_an_axis_flies_it(setpoint, stick, others):
    """Channels of ArduPilot as RCMAP_* have them by default; sticks of PX4 from -1 to 1, by old names and new."""
    time = np.arange(0, 30, 0.05)
    sine = np.where((time > 5) & (time < 25), np.sin(3 * time), 0)
    size, center = (300.0, 1500.0) if stick.startswith("RCIN") else (0.5, 0.0)
    for moving in ((stick,), others):
        values = {name: center + size * sine * (name in moving) for name in (stick, *others)} | {
            setpoint: 0.1 * sine
        }
        records = {}
        for name, one in values.items():
            message, _, field = name.partition(".")
            records.setdefault(message, {})[field] = one
        (found,) = find_segments(
            Recording({name: Record(time, signals) for name, signals in records.items()})
        )
        assert found.usable is (moving == others)


def test_sines_of_the_system_identification_mode_are_as_long_as_they_were_set():
    """They are not held against one another; a run whose data end a tenth of a second early is whole."""
    setting = {
        "Ax": [10.0] * 3,
        "Mag": [0.1, 0.1, 1e-4],
        "FSt": [0.5] * 3,
        "FSp": [0.5] * 3,
        "TR": [60.0, 60.0, 10.0],
    }
    time = np.concatenate(
        [
            100 + np.arange(0, 60.95, 0.01),
            200 + np.arange(0, 60.8, 0.01),
            300 + np.arange(0.01, 20, 0.01),
        ]
    )
    log = Recording(
        {"SIDS": Record([100.0, 200.0, 300.0], setting), "SIDD": Record(time, {"Targ": 0 * time})}
    )
    found = find_segments(log)
    assert [(s.kind, s.axis, s.usable) for s in found] == [
        ("sine", "mixer roll", True), ("sine", "mixer roll", False), ("sine", "mixer roll", True),
    ]  # fmt: skip
    assert [s.start for s in found] == [101.0, 201.0, 301.0]
    assert found[2].end == 311.0
    assert found[1].findings == ("ended early, after 59.8 of 60.0 s",)
