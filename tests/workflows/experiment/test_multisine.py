import math

import numpy as np
import pytest

from greybox.workflows.experiment.multisines import multisine


@pytest.mark.parametrize("signals", [["u"], ["p", "q", "r"]])
def test_multisines_are_orthogonal_and_start_at_zero(signals):
    made = multisine(1.0, 20.0, 20.0, 100, amplitude=0.1, signals=signals)
    period = np.array([made[name][:2000] for name in signals])
    gram = period @ period.T
    np.testing.assert_allclose(gram, np.diag(np.diag(gram)), atol=1e-12 * gram.max())
    np.testing.assert_allclose(np.abs(period).max(axis=1), 0.1)
    np.testing.assert_allclose(period[:, 0], 0, atol=1e-14)
    np.testing.assert_array_equal(made[signals[0]][:2000], made[signals[0]][2000:4000])
    assert not set.intersection(*map(set, made.settings["harmonics"].values())) or len(signals) == 1


def test_power_is_equal_and_in_the_band():
    made = multisine(1.0, 20.0, 20.0, 100, signals=["p", "q"])
    step = 2 * math.pi / 20
    for name, harmonics in made.settings["harmonics"].items():
        size = np.abs(np.fft.rfft(made[name][:2000]))
        excited = np.zeros(size.size, dtype=bool)
        excited[list(harmonics)] = True
        np.testing.assert_allclose(size[excited], size[excited][0], rtol=1e-9)
        assert size[~excited].max() < 1e-9 * size.max()
        assert min(harmonics) * step >= 1.0
        assert max(harmonics) * step <= 20.0


@pytest.mark.parametrize(("periods", "settled"), [(1, 0.0), (3, 20.0)])
def test_the_schedule_and_the_settings_say_what_is_flown(periods, settled):
    made = multisine(
        1.0, 5.0, 20.0, 50, amplitude=0.2, signals=["p", "q"], periods=periods, unit="rad"
    )
    step = 2 * math.pi / 20
    assert made.settings == {
        "period": 20.0,
        "harmonics": {"p": (4, 6, 8, 10, 12, 14), "q": (5, 7, 9, 11, 13, 15)},
    }
    assert [(m.signal, m.kind, m.amplitude, m.offset) for m in made.schedule] == [
        ("p", "multisine", 0.2, 0.0),
        ("q", "multisine", 0.2, 0.0),
    ]
    for m, (first, last) in zip(made.schedule, ((4, 14), (5, 15)), strict=True):
        assert (m.start, m.settled, m.end) == (0.0, settled, 20.0 * periods)
        assert (m.low, m.high) == pytest.approx((first * step, last * step))
    assert made.time.size == 1000 * periods
    assert made.time[:3] == pytest.approx([0.0, 0.02, 0.04])
    assert made.units == {"p": "rad", "q": "rad"}
    # Each begins with a rising zero.
    assert all(made[name][1] > 0 > made[name][-1] for name in ("p", "q"))


def test_peaks_are_low():
    """Schroeder's phases alone give about 1.2 for flat spectra; a sine has 1, random phases 2 to 3."""
    dense = multisine(1.0, 20.0, 20.0, 100)
    assert dense.peak_factors["u"] < 1.06
    assert (
        max(multisine(1.0, 20.0, 20.0, 100, signals=["p", "q", "r"]).peak_factors.values()) < 1.25
    )
    assert "peak factor 1.0" in str(dense)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((1.0, 20.0, 20.003, 100), "make that a whole number"),
        ((1.0, 1.2, 20.0, 100), "lengthen the period"),
        ((1.0, 200.0, 20.0, 100), "raise the rate"),
    ],
)
def test_mistakes_are_sentences(arguments, words):
    with pytest.raises(ValueError, match=words):
        multisine(*arguments)


def test_a_period_that_is_written_with_seven_digits_is_a_whole_number_of_samples():
    assert len(multisine(1.0, 20.0, 6.666667, 150)) == 4 * 1000
