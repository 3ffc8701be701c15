import math

import numpy as np
import pytest

from greybox.workflows.experiment.sine_schedules import sine_schedule


def test_sine_schedule_repeats_the_simulated_flight():
    """The flights in the simulator lasted so many periods, lead-in of two seconds included."""
    omega = [20.11, 16.01, 12.03, 8.0, 5.34, 4.0, 3.5, 3.0, 2.0, 1.0]
    made = sine_schedule(omega, math.radians(3), offset=math.radians(5))
    periods = [(s.end - s.start) * s.low / (2 * math.pi) for s in made.schedule]
    np.testing.assert_allclose(periods, [56, 45, 33, 23, 15, 12, 12, 11, 11, 11], atol=1e-9)
    assert all(s.settled - s.start >= 2 and s.end - s.settled >= 15 - 1e-9 for s in made.schedule)


def test_sine_schedule_is_the_formula():
    made = sine_schedule([3.0, 1.0], [0.1, 0.2], offset=0.5, rate=200)
    for s in made.schedule:
        inside = (made.time >= s.start) & (made.time < s.end)
        expected = 0.5 + s.amplitude * np.sin(s.low * (made.time[inside] - s.start))
        np.testing.assert_allclose(made["reference"][inside], expected, atol=1e-12)
    assert made["reference"][0] == made["reference"][-1] == 0.5
    assert np.abs(np.diff(made["reference"])).max() < 0.2 * 3.0 / 200  # no jumps
    first, second = made.schedule
    assert [s[:2] for s in made.schedule] == [("reference", "sine")] * 2
    assert [(s.low, s.high, s.amplitude, s.offset) for s in made.schedule] == [
        (3, 3, 0.1, 0.5),
        (1, 1, 0.2, 0.5),
    ]
    pause = made.settings["pause"]
    assert first.start == pause > 0
    assert second.start - first.end == pytest.approx(pause)
    assert made.time[-1] - second.end == pytest.approx(pause, abs=1 / 200)
    between = (made.time >= first.end) & (made.time < second.start)
    assert np.all(made["reference"][between] == 0.5)
    assert len(made) == made.time.size
    assert "sine on reference" in str(made)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: sine_schedule([-1.0], 0.1), "omega is -1 rad/s"),
        (lambda: sine_schedule([], 0.1), "omega is empty"),
        (lambda: sine_schedule([300.0], 0.1), "raise the rate"),
        (lambda: sine_schedule([1.0, 2.0, 3.0], [0.1, 0.2]), "3 frequencies but 2 amplitudes"),
    ],
)
def test_mistakes_are_sentences(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_sines_have_a_hundred_samples_a_second_unless_stated():
    assert sine_schedule([1.0], 0.1).rate == pytest.approx(100)
    made = sine_schedule([1.0], 0.1, rate=40.0)
    assert (made.rate, np.diff(made.time)[0]) == pytest.approx((40.0, 1 / 40))


def test_amplitudes_and_periods_are_one_or_one_for_each_frequency():
    with pytest.raises(ValueError, match="there are 3 frequencies but 2 numbers of periods"):
        sine_schedule([1.0, 2.0, 3.0], 0.1, periods=[4, 5])
    with pytest.raises(
        ValueError, match="there are 3 frequencies but 2 amplitudes: give one for each"
    ):
        sine_schedule([1.0, 2.0, 3.0], [0.1, 0.2])
    made = sine_schedule([1.0, 2.0, 3.0], [0.3, 0.2, 0.1], periods=[4, 5, 6], least=0.0)
    assert [s.amplitude for s in made.schedule] == [0.3, 0.2, 0.1]
    assert [(s.end - s.settled) * s.low / (2 * math.pi) for s in made.schedule] == pytest.approx(
        [4, 5, 6]
    )
