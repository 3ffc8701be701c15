"""Fourier integrals of manoeuvres against analytic ones."""

import numpy as np
import pytest

import greybox as gb
from greybox.data.spectral import transient_spectrum, transients

T, STEP = 8.0, 0.02


def record(u, y, step=STEP, hold=None):
    t = np.arange(round(T / step) + 1) * step
    return gb.Record(t, {"u": u(t), "y": y(t)}, hold=hold or {})


def test_integrals_are_the_analytic_ones():
    """An exponential and a ramp, which end elsewhere than they began; constants are nothing."""
    spectrum = transient_spectrum(
        record(lambda t: 3 + np.exp(-t), lambda t: 0.2 * t - 7), "u", "y", (0.5, 40)
    )
    s = 1j * spectrum.omega
    np.testing.assert_allclose(spectrum.omega, 2 * np.pi / T * np.arange(1, 51))
    np.testing.assert_allclose(spectrum.outputs["y"], -0.2 * T / s, rtol=1e-9)
    # The trapezoidal rule is off by step²/12 times the change of the slope.
    off = np.abs(spectrum.inputs["u"] - (1 - np.exp(-T)) / (s + 1))
    assert np.all(off < 1.1 * STEP**2 / 12 * np.exp(0))
    assert np.sum(spectrum.input_changes["u"][1]) == pytest.approx(np.exp(-T) - 1)


def test_held_signals_are_integrated_as_held():
    """A pulse of ten samples, exactly."""

    def pulse(t):
        return 1.0 * ((t > 0.99) & (t < 1.19))

    spectrum = transient_spectrum(record(pulse, pulse, hold={"u": np.inf}), "u", "y", (0.5, 100))
    s = 1j * spectrum.omega
    exact = (np.exp(-s * 1.0) - np.exp(-s * 1.2)) / s
    np.testing.assert_allclose(spectrum.inputs["u"], exact, atol=1e-12)
    # A signal that acts later, after the value it had before.
    late = (np.exp(-s * 1.3) - np.exp(-s * 1.5)) / s
    np.testing.assert_allclose(spectrum.delayed_input("u", 0.3)[0], late, atol=1e-12)


def test_an_input_that_ends_elsewhere_is_delayed_exactly():
    """A step, whose late part is not in the manoeuvre any more."""
    spectrum = transient_spectrum(
        record(lambda t: 2.0 * (t > 0.99), np.sin, hold={"u": np.inf}), "u", "y", (0.5, 100)
    )
    s = 1j * spectrum.omega
    exact = 2 * (np.exp(-s * 1.5) - 1) / s  # exp(-sT) = 1
    np.testing.assert_allclose(spectrum.delayed_input("u", 0.5)[0], exact, atol=1e-12)


def test_an_input_that_changes_at_the_end_is_delayed_exactly():
    """A step 0.2 s before the end and the last sample, of which a delay leaves out what is late.

    Changes take 2 % of a sample, so that the cost has no corners.
    """
    spectrum = transient_spectrum(
        record(lambda t: 2.0 * (t > T - 0.21) + (t > T - 0.01), np.sin, hold={"u": np.inf}),
        "u",
        "y",
        (0.5, 100),
    )
    s = 1j * spectrum.omega
    np.testing.assert_allclose(
        spectrum.delayed_input("u", 0.15)[0], 2 * (np.exp(s * 0.05) - 1) / s, atol=1e-3
    )
    np.testing.assert_allclose(spectrum.delayed_input("u", 0.3)[0], 0 * s, atol=1e-3)


def test_errors_of_white_noise_are_independent_and_of_known_size():
    """The variance σ² · step · duration at every line, and no correlation between lines."""
    random = np.random.default_rng(0)
    rows = []
    for _ in range(400):
        values = random.standard_normal(round(T / STEP) + 1)
        rows.append(
            transient_spectrum(record(np.sin, lambda t, v=values: v), "u", "y", (0.5, 10)).outputs[
                "y"
            ]
        )
    rows = np.array(rows)
    covariance = rows.conj().T @ rows / len(rows) / (STEP * T)
    np.testing.assert_allclose(np.diag(covariance).real, 1, atol=5 / np.sqrt(400))
    assert np.abs(covariance - np.diag(np.diag(covariance))).max() < 5 / np.sqrt(400)
    assert np.abs(rows.T @ rows / len(rows) / (STEP * T)).max() < 5 / np.sqrt(
        400
    )  # real and imaginary part alike


@pytest.mark.parametrize(
    ("band", "words"),
    [
        ((0.1, 0.5), r"has no multiple of 0\.7854 rad/s"),
        ((1, 200), r"125\.7 rad"),
        (
            (1, 126),
            r"0\.4 of the sampling rate",
        ),
        ((5, 1), "the lower one first"),
    ],
)
def test_bands_that_a_manoeuvre_cannot_serve(band, words):
    """In one sentence."""
    with pytest.raises(ValueError, match=words):
        transient_spectrum(record(np.sin, np.cos), "u", "y", band)


def test_changes_of_zero_are_not_stored():
    def steps(t):
        return np.select([t < 1, t < 3, t < 5], [0.0, 1.0, -1.0], 0.5)

    spectrum = transient_spectrum(record(steps, np.sin, hold={"u": np.inf}), "u", "y", (0, 10))
    np.testing.assert_array_equal(spectrum.input_changes["u"][1], [1.5, -2.0, 1.0])


def test_a_record_with_a_gap_is_refused():
    """Integrals run over gaps to nowhere."""
    whole = record(np.sin, np.cos)
    rows = np.flatnonzero((whole.time < 3) | (whole.time > 4))
    with pytest.raises(ValueError, match="2 stretches between gaps"):
        transient_spectrum(whole.rows(rows), "u", "y", (0.5, 10))


def test_a_spectrum_off_the_grid_is_refused():
    """Its errors would be correlated."""
    with pytest.raises(ValueError, match=r"increasing multiples of 0\.785398"):
        gb.data.TransientSpectrum(np.array([1.0]), {"u": np.ones(1)}, {"y": np.ones(1)}, 8.0, 0.02)


@pytest.mark.parametrize("duration", [0.7, 3.3, 12.1])
def test_a_band_from_line_to_line_holds_both(duration):
    """Whatever rounding makes of their frequencies; one that ends between two holds those inside."""
    spacing = 2 * np.pi / duration
    for first, last in ((1, 2), (3, 7), (11, 49)):
        found = transients.lines_in_band(
            (first * 2 * np.pi / duration, last * spacing), duration, 1e-3
        )
        assert found / spacing == pytest.approx(np.arange(first, last + 1))
        inside = transients.lines_in_band(
            (first * spacing * 1.001, last * spacing * 1.001), duration, 1e-3
        )
        assert inside / spacing == pytest.approx(np.arange(first + 1, last + 1))
        tight = (first * spacing * (1 + 1e-12), last * spacing * (1 - 1e-12))
        assert transients.lines_in_band(tight, duration, 1e-3).size == last - first + 1
    assert transients.lines_in_band(
        (0.0, 2.5 * spacing), duration, 1e-3
    ) / spacing == pytest.approx([1, 2])


def test_a_manoeuvre_may_begin_at_any_time_and_reach_to_the_highest_frequency():
    made = record(lambda t: np.exp(-t), np.sin)
    late = gb.Record(made.time + 50, dict(made.signals), {"u": "N"}, name="late", source="a.bin")
    early, found = (transient_spectrum(r, "u", ["y"], (1, 125)) for r in (made, late))
    np.testing.assert_allclose(found.omega, early.omega)
    assert found.omega[-1] == pytest.approx(2 * np.pi / T * 159)
    np.testing.assert_allclose(found.inputs["u"], early.inputs["u"])
    np.testing.assert_allclose(found.outputs["y"], early.outputs["y"])
    assert (found.duration, found.step) == (pytest.approx(T), pytest.approx(STEP))
    assert (found.name, found.source, dict(found.units)) == ("late", "a.bin", {"u": "N"})
    assert (found.stretch.start, found.stretch.end) == (50, 58)


def test_an_input_that_lasted_for_part_of_a_step_acts_half_of_that_later():
    """Both as far as a pulse that is over before the manoeuvre ends."""

    def pulse(t):
        return np.exp(-4 * (t - 3.0) ** 2)

    plain, late = (
        transient_spectrum(record(pulse, np.sin, hold=h), "u", "y", (0.5, 20))
        for h in ({}, {"u": 0.008})
    )
    s = 1j * plain.omega
    np.testing.assert_allclose(late.inputs["u"], plain.inputs["u"] * np.exp(-0.004 * s), atol=1e-9)
    np.testing.assert_allclose(late.outputs["y"], plain.outputs["y"])
