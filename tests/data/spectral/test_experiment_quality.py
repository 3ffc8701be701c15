"""The data check: every kind of bad test is found and named, and a good one passes."""

import numpy as np
import pytest

import greybox as gb
from greybox.data.excited_segment import Segment
from greybox.data.record import Record
from greybox.data.spectral.experiment_quality import Finding, check

RANDOM = np.random.default_rng(3)


def record(duration=60.0, rate=50.0, u=None, y=None, time=None):
    time = np.arange(int(duration * rate)) / rate if time is None else time
    u = np.sin(3 * time) if u is None else u(time)
    y = np.sin(3 * time - 0.4) if y is None else y(time)
    return Record(time, {"u": u, "theta": y}, {"theta": "rad"}, hold={"u": 0.0})


def sine(omega, start=0.0, end=60.0, **more):
    return Segment(start, end, omega=omega, axis="pitch", **more)


GOOD = [sine(1.0), sine(3.0), sine(9.0)]


def found(quality):
    return {f.about: f.severity for f in quality.findings}


def test_a_good_test_passes():
    quality = check(record(), None, GOOD)
    assert quality.usable
    assert found(quality) == {}
    assert str(quality) == "no problems found"


@pytest.mark.parametrize(
    ("made", "segments", "about", "severity"),
    [
        (
            record(u=lambda t: np.clip(2 * np.sin(3 * t), -1.95, 1.95)),
            GOOD,
            "saturation",
            "warning",
        ),
        (record(u=lambda t: np.clip(5 * np.sin(3 * t), -1, 1)), GOOD, "saturation", "refusal"),
        (record(u=np.zeros_like), GOOD, "amplitude", "refusal"),
        (record(y=lambda t: np.round(0.6 * np.sin(3 * t))), GOOD, "amplitude", "refusal"),
        (record(rate=10.0), GOOD, "rate", "warning"),
        (record(rate=0.3), GOOD, "rate", "refusal"),
        (record(), [sine(0.05), sine(0.07)], "length", "refusal"),
        (record(), [sine(0.2), sine(3.0)], "length", "warning"),
        (record(), [sine(3.0)], "spread", "refusal"),
        (record(), [sine(3.0), sine(4.0)], "spread", "warning"),
        (record(), [sine(3.0, usable=False, findings=("aborted",))], "segments", "refusal"),
        (record(), [*GOOD, sine(20.0, usable=False, findings=("aborted",))], "segments", "warning"),
    ],
)
def test_a_bad_test_is_named(made, segments, about, severity):
    quality = check(made, None, segments)
    assert severity in [f.severity for f in quality.findings if f.about == about]
    assert quality.usable == (severity != "refusal")


def test_gaps_and_jitter_are_named():
    time = np.arange(3000) / 50
    time = time[(time < 20) | (time > 30)] + 0.008 * RANDOM.uniform(
        -1, 1, np.sum((time < 20) | (time > 30))
    )
    assert found(check(record(time=time), None, GOOD)) == {"gaps": "warning", "jitter": "note"}


def response(noise, coherence=None):
    omega = np.geomspace(1, 10, 12)
    size = np.ones(12)
    return gb.FrequencyResponse(
        omega,
        size,
        variance=2 * (noise * size) ** 2,
        coherence=None if coherence is None else coherence * size,
    )


@pytest.mark.parametrize(
    ("measured", "expected"),
    [
        (response(0.01, 0.99), {}),
        (response(0.2), {"noise": "warning"}),
        (response(0.7), {"noise": "refusal"}),
        (response(0.01, 0.5), {"coherence": "warning"}),
        (response(0.01, 0.1), {"coherence": "refusal"}),
    ],
)
def test_a_response_of_the_size_of_the_noise_is_refused(measured, expected):
    assert found(check(record(), measured, GOOD)) == expected


def test_a_signal_that_is_not_there_is_named():
    with pytest.raises(KeyError, match="no signal 'q'; it has u, theta"):
        check(record(), input="q")


def test_without_tests_the_length_counts_periods_of_the_lowest_frequency_of_the_response():
    response = gb.FrequencyResponse([0.3, 1.0, 3.0, 9.0], np.ones(4), input="u", output="theta")
    (length,) = [f for f in check(record(), response).findings if f.about == "length"]
    assert length.value == pytest.approx(60 * 0.3 / (2 * np.pi), rel=1e-3)
    assert length.severity == "warning"


def test_a_sweep_beyond_the_logging_rate_is_used_up_to_where_it_can_be():
    sweep = Segment(0.0, 60.0, "sweep", band=(0.6, 80.0))
    slow = record(rate=20.0)
    assert check(slow, None, [sweep]).usable
    measured = gb.FrequencyResponse([1.0, 10.0, 45.0], [1, 1, 1])
    findings = check(slow, measured, [sweep]).findings
    (note,) = (f for f in findings if f.severity == "note" and f.about == "rate")
    assert "it is used up to 45 rad/s" in note.text


def test_gaps_outside_of_the_tests_do_not_count():
    whole = record()
    broken = whole.rows(np.flatnonzero((whole.time < 30) | (whole.time > 35)))
    tests = [
        Segment(0.0, 29.0, "sweep", band=(1.0, 9.0)),
        Segment(36.0, 60.0, "sweep", band=(1.0, 9.0)),
    ]
    assert [f for f in check(broken, None, tests).findings if f.about == "gaps"] == []
    assert [f.value for f in check(broken, None).findings if f.about == "gaps"] == [
        pytest.approx(5 / 60, rel=0.02)
    ]


def levels(count):
    """A sine that takes so many values."""
    return lambda t: np.round((count - 1) * (1 + np.sin(3 * t)) / 2)


def clipped(share):
    """A sine that is at its limits for a share of the time: beyond ±1, of an amplitude a, where |sin| > 1/a."""
    return lambda t: np.clip(np.sin(3 * t) / np.sin(np.pi / 2 * (1 - share)), -1, 1)


def gap_of(share):
    time = np.arange(6000) / 100
    return time[(time < 20) | (time > 20 + 60 * share)]


def jittered(share):
    """Intervals of two lengths."""
    return np.cumsum(0.02 * (1 + share * np.tile([1, -1], 1500)))


@pytest.mark.parametrize(
    ("made", "about", "severity"),
    [
        (record(u=clipped(0.006), rate=200.0), "saturation", None),
        (record(u=clipped(0.02), rate=200.0), "saturation", "warning"),
        (record(u=clipped(0.18), rate=200.0), "saturation", "warning"),
        (record(u=clipped(0.23), rate=200.0), "saturation", "refusal"),
        (record(y=levels(3)), "amplitude", "refusal"),
        (record(y=levels(4)), "amplitude", "warning"),
        (record(y=levels(7)), "amplitude", "warning"),
        (record(y=levels(8)), "amplitude", None),
        (record(time=gap_of(0.008)), "gaps", "note"),
        (record(time=gap_of(0.013)), "gaps", "warning"),
        (record(time=jittered(0.09)), "jitter", None),
        (record(time=jittered(0.11)), "jitter", "note"),
    ],
)
def test_a_record_is_judged_by_the_stated_shares(made, about, severity):
    """On both sides of 1 and 20 % at a limit, 4 and 8 values, 1 % of gaps and 10 % of jitter."""
    assert found(check(made, None, GOOD)).get(about) == severity


@pytest.mark.parametrize(
    ("periods", "severity"), [(0.95, "refusal"), (1.05, "warning"), (2.9, "warning"), (3.1, None)]
)
def test_a_test_is_judged_by_the_periods_of_its_lowest_frequency(periods, severity):
    segments = [sine(2 * np.pi * periods / 60), sine(1.0), sine(3.0)]
    (length,) = [f for f in check(record(), None, segments).findings if f.about == "length"] or [
        None
    ]
    assert (length and length.severity) == severity
    if length:
        assert length.value == pytest.approx(periods)


@pytest.mark.parametrize(
    ("measured", "about", "severity", "said"),
    [
        (response(0.099), "noise", None, ""),
        (
            response(0.11),
            "noise",
            "warning",
            "half of the points have a standard deviation above 11 %: excite more",
        ),
        (response(0.49), "noise", "warning", "above 49 %"),
        (response(0.51), "noise", "refusal", "above 51 %"),
        (response(0.01, 0.61), "coherence", None, ""),
        (
            response(0.01, 0.59),
            "coherence",
            "warning",
            "half of the points have a coherence below 0.59: the output is",
        ),
        (response(0.01, 0.21), "coherence", "warning", "below 0.21"),
        (response(0.01, 0.19), "coherence", "refusal", "below 0.19"),
    ],
)
def test_a_response_is_judged_by_the_stated_coherence_and_error(measured, about, severity, said):
    """On both sides of 0.6 and 0.2, and of 10 and 50 %."""
    texts = [f for f in check(record(), measured, GOOD).findings if f.about == about]
    assert [f.severity for f in texts] == ([severity] if severity else [])
    assert all(said in f.text for f in texts)


@pytest.mark.parametrize(("size", "count"), [(0.49, 0), (0.51, 2)])
def test_single_points_that_hardly_count_are_named(size, count):
    made = response(0.01)
    error = np.where(np.arange(12) < 2, size, 0.01) * np.abs(made.response)
    measured = gb.FrequencyResponse(made.omega, made.response, variance=2 * error**2)
    notes = [f for f in check(record(), measured, GOOD).findings if f.about == "noise"]
    assert [(f.severity, f.value) for f in notes] == [("note", count)] * (count > 0)
    assert all("50 % of the magnitude at 1 and 1.23 rad/s: these" in f.text for f in notes)


@pytest.mark.parametrize(
    ("count", "places"), [(1, "1"), (5, "1, 1.23, 1.52, 1.87 and 2.31"), (6, "1.87 and 2 more")]
)
def test_points_of_low_coherence_are_named(count, places):
    made = response(0.01, 0.9)
    weak = gb.FrequencyResponse(
        made.omega,
        made.response,
        variance=made.variance,
        coherence=np.where(np.arange(12) < count, 0.59, 0.61),
    )
    (text,) = [f for f in check(record(), weak, GOOD).findings if f.about == "coherence"]
    assert (text.severity, text.value) == ("warning", count)
    assert f"{places} rad/s: leave out these points" in text.text


@pytest.mark.parametrize(("highest", "severity"), [(3.97, "warning"), (4.0, None)])
def test_less_than_an_octave_is_told(highest, severity):
    found = [
        f for f in check(record(), None, [sine(2.0), sine(highest)]).findings if f.about == "spread"
    ]
    assert [f.severity for f in found] == ([severity] if severity else [])
    assert all(
        "covers 2 to 3.97 rad/s" in f.text and f.value == pytest.approx(3.97 / 2) for f in found
    )


@pytest.mark.parametrize(
    ("samples", "severity"), [(10.1, None), (9.9, "warning"), (2.51, "warning"), (2.4, "refusal")]
)
def test_samples_per_period_are_those_of_the_highest_frequency(samples, severity):
    omega = 2 * np.pi * 50 / samples
    measured = gb.FrequencyResponse([1.0, 5.0, omega], [1, 1, 1])
    found = [f for f in check(record(), measured, GOOD).findings if f.about == "rate"]
    assert [f.severity for f in found] == ([severity] if severity else [])
    assert all(
        f.text.startswith(f"there are {samples:.2g} samples per period of the highest")
        for f in found
    )


@pytest.mark.parametrize(("above", "notes"), [(1.0005, 0), (1.002, 1)])
def test_a_sweep_to_the_end_of_what_the_rate_resolves_is_not_cut(above, notes):
    sweep = Segment(0.0, 60.0, "sweep", band=(0.6, above * 2 * np.pi * 20 / 2.5))
    findings = check(record(rate=20.0), None, [sweep]).findings
    assert sum(f.about == "rate" and f.severity == "note" for f in findings) == notes


def test_a_gap_among_steady_samples_is_no_jitter():
    time = np.arange(3000) / 50
    assert found(check(record(time=time[(time < 20) | (time > 30)]), None, GOOD)) == {
        "gaps": "warning"
    }


def test_a_control_at_its_limit_outside_of_the_tests_does_not_count():
    made = record(u=lambda t: np.where(t < 30, np.sin(3 * t), np.clip(5 * np.sin(3 * t), -1, 1)))
    segments = [Segment(0.0, 29.9, "sweep", band=(1.0, 9.0))]
    assert "saturation" not in found(check(made, None, segments))
    assert found(check(made, None, GOOD))["saturation"] == "refusal"


def test_two_values_are_few_and_one_is_a_constant():
    two, one = (
        check(record(y=levels(2)), None, GOOD),
        check(record(u=lambda t: np.full(t.size, 2.5)), None, GOOD),
    )
    (few,) = two.findings
    assert (few.severity, few.value) == ("refusal", 2)
    assert "theta takes only 2 values" in few.text
    (constant,) = [f for f in one.findings if f.about == "amplitude"]
    assert "u is constant (2.5" in constant.text
    assert (constant.severity, constant.value) == ("refusal", 0)
    refused = check(record(), None, [sine(3.0, usable=False, findings=("aborted.",))])
    assert ["fly the test again" in text for text in refused.refusals] == [True]
    (aborted,) = [f for f in refused.findings if f.severity == "warning"]
    assert aborted.text.endswith("not usable: aborted.")
    assert aborted.value == 0


def test_findings_hold_their_numbers_and_print_the_most_serious_first():
    """Two gaps of 1 and 3 s in 48 s, a control at its limits for half of the time, one octave measured."""
    time = np.arange(4800) / 100
    kept = (np.abs(time - 10.5) > 0.499) & (np.abs(time - 30.5) > 1.499)
    u = np.sign(np.sin(3 * time)) * np.minimum(1, np.abs(2 * np.sin(3 * time)) ** 0.5)
    noisy = gb.FrequencyResponse(
        [1.0, 1.5, 1.9],
        [2, 2, 2],
        variance=[0.02, 0.18, 0.5],
        coherence=[0.9, 0.55, 0.4],
        input="u",
        output="theta",
    )
    signals = {"u": u[kept], "theta": np.sin(time[kept])}
    quality = check(Record(time[kept], signals, hold={"u": 0.0}), noisy)
    told = {f.about: (f.severity, f.value, f.text) for f in quality.findings}
    share = 4.0 / 47.99
    assert told["gaps"][0] == "warning"
    assert told["gaps"][1] == pytest.approx(share)
    assert told["gaps"][2].startswith("2 gaps, the longest 3 s, take 8.3 % of the time")
    limited = np.mean(np.abs(np.sin(3 * time[kept])) > 0.5)
    assert told["saturation"][0] == "refusal"
    assert told["saturation"][1] == pytest.approx(limited, abs=0.01)
    assert told["saturation"][2].startswith(
        f"the control u rests at its largest or smallest value for {100 * told['saturation'][1]:.0f} % of"
    )
    assert told["noise"][:2] == ("warning", pytest.approx(np.sqrt(0.18 / 2) / 2))
    assert told["noise"][2].startswith("half of the points have a standard deviation above 15 %")
    assert told["length"][:2] == ("warning", pytest.approx(18 / (2 * np.pi), rel=2e-3))
    assert told["spread"][:2] == ("warning", pytest.approx(1.9))
    assert [f.value for f in quality.findings if f.about == "coherence"] == [2, 0.55]
    assert [f.severity for f in quality.findings] == ["refusal", *["warning"] * 6]
    assert quality.refusals == (told["saturation"][2],)
    lines = str(quality).splitlines()
    assert lines[0] == f"refusal: {told['saturation'][2]}"
    assert repr(quality).startswith("<Quality refusal: the control u rests at its largest or ")
    worse = quality.with_findings(
        Finding("test", "note", 1.0, "a"), Finding("test", "refusal", 2.0, "b")
    )
    assert [f.text for f in worse.findings][1] == "b"
    assert [f.text for f in worse.findings][-1] == "a"


@pytest.mark.parametrize(
    ("segments", "told"),
    [
        (
            [sine(5.0), sine(10.0), sine(60.0)],
            [],
        ),  # what is sampled too slowly is left out, where there is more
        ([sine(51.0), sine(60.0)], [("refusal", 2 * np.pi * 20 / 60)]),
        ([sine(5.0), sine(20.0)], [("warning", 2 * np.pi)]),
        ([Segment(0.0, 60.0, "sweep", band=(0.6, 80.0))], [("warning", 2.5), ("note", 80.0)]),
        (
            [Segment(0.0, 60.0, "sweep", band=(0.6, 80.0)), sine(60.0)],
            [("warning", 2.5), ("note", 80.0)],
        ),
        ([Segment(0.0, 60.0, "sweep", band=(0.6, 10.0)), sine(60.0)], []),
        ([Segment(0.0, 60.0, "sweep", band=(55.0, 80.0))], [("refusal", 2 * np.pi * 20 / 80)]),
    ],
)
def test_at_twenty_hertz_fifty_radians_a_second_are_the_highest(segments, told):
    """2.5 samples a period; ten of them are at 12.6 rad/s."""
    rate = [f for f in check(record(rate=20.0), None, segments).findings if f.about == "rate"]
    assert [(f.severity, f.value) for f in rate] == [(s, pytest.approx(v)) for s, v in told]
    if told and told[-1][0] == "note":
        assert "50.27 rad/s" in rate[-1].text
        assert rate[0].text.startswith(
            "there are 2.5 samples per period of the highest frequency, 50.2655 rad/s: log"
        )


@pytest.mark.parametrize("levels", [(-1, 1), (-1, 0, 1), (-2, -1, 1, 3)])
def test_sequences_of_steps_are_not_called_saturated(levels):
    """Binary sequences, doublets and 3-2-1-1 rest at their extremes by design."""
    steps = np.repeat(RANDOM.choice(levels, 150), 20)
    quality = check(record(u=lambda t: 0.1 * steps[: t.size]), None, GOOD)
    assert "saturation" not in found(quality)


def test_a_clipped_control_that_is_held_between_updates_is_called_saturated():
    """A controller at 10 Hz in a log of 50 Hz."""
    made = record(u=lambda t: np.clip(2 * np.sin(3 * np.floor(10 * t) / 10), -1, 1))
    assert found(check(made, None, GOOD))["saturation"] == "refusal"


def test_a_binary_sequence_is_no_signal_of_low_resolution():
    steps = np.repeat(RANDOM.choice([-1.0, 1.0], 300), 10)
    quality = check(record(u=lambda t: 0.1 * steps[: t.size]), None, GOOD)
    assert "amplitude" not in found(quality)
