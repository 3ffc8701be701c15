"""Fourier integrals of one manoeuvre: the delay against an integral, and what is no such spectrum."""

import re

import numpy as np
import pytest
from scipy.integrate import trapezoid

from greybox.data.transient_spectrum import TransientSpectrum

T = 3.7
OMEGA = 2 * np.pi / T * np.array([1, 2, 5, 9])
KNOWN = {
    "omega": OMEGA,
    "inputs": {"u": [1 + 2j, 2 - 1j, 3j, 0.5]},
    "outputs": {"y": [4 + 2j, 1 - 1j, 0.3j, 0.1]},
    "duration": T,
    "step": 0.02,
}


def spectrum(**changes):
    return TransientSpectrum(**KNOWN | changes)


def integral(t, x):
    """∫ x exp(-jωt) dt by the trapezoidal rule, (n,)."""
    return trapezoid(x * np.exp(-1j * np.outer(OMEGA, t)), t, axis=1)


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.1])
def test_a_delayed_input_is_the_integral_of_the_delayed_signal(delay):
    """From its first value before the manoeuvre; its last one is kept for the delay at the end."""
    t = np.linspace(0, T, 40_001)
    last = T - 1.1

    def u(at):
        return 0.7 + 1.3 * np.sin(2.1 * np.clip(at, 0, last)) + 0.4 * np.clip(at, 0, last)

    changes = {"u": [[T], [u(T) - u(0)]]}
    made = spectrum(inputs={"u": integral(t, u(t)), "v": OMEGA}, input_changes=changes)
    assert made.delayed_input("u", delay)[0] == pytest.approx(integral(t, u(t - delay)), abs=1e-6)
    assert made.delayed_input("v", delay)[0] == pytest.approx(OMEGA * np.exp(-1j * OMEGA * delay))


@pytest.mark.parametrize("delay", [0.1, 0.25, 0.9])
@pytest.mark.parametrize("held", [(), ("u",)])
def test_what_an_input_does_at_the_end_acts_later(delay, held):
    """Steps, or lines of one sample, 0.8 and 0.2 s before the end; the derivative by differences."""
    t, step = np.linspace(0, T, 80_001), 0.02
    times, changes = np.array([T - 1, 0.8, 0.2]), np.array([1.0, -0.7, 0.4])
    width = step * 1e-3 if held else step

    def u(at):
        rising = np.clip((at[:, None] - T + times) / width + 1, 0, 1)
        return 0.3 + rising @ changes

    made = spectrum(
        inputs={"u": integral(t, u(t))}, input_changes={"u": [times, changes]}, held=held
    )
    late, slope = made.delayed_input("u", delay)
    assert late == pytest.approx(integral(t, u(t - delay)), abs=4e-4)
    ends = [made.delayed_input("u", delay + change)[0] for change in (1e-6, -1e-6)]
    assert slope == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"duration": np.inf},
            "duration is inf s and step 0.02 s",
        ),
        ({"step": 0.0}, "above 0 and shorter than the duration"),
        ({"step": -0.1}, "above 0 and shorter than the duration"),
        ({"step": T}, "above 0 and shorter than the duration"),
        (
            {"omega": []},
            "omega must be increasing multiples of 1.69816 rad/s, 2π over the duration",
        ),
        ({"omega": OMEGA[::-1]}, "omega must be increasing multiples"),
        ({"omega": OMEGA[[0, 1, 1, 2]]}, "omega must be increasing multiples"),
        ({"omega": OMEGA - OMEGA[0]}, "omega must be increasing multiples"),  # begins with zero
        ({"omega": -OMEGA[::-1]}, "omega must be increasing multiples"),
        ({"omega": OMEGA * (1 + 1.1e-6)}, "omega must be increasing multiples"),
        ({"omega": OMEGA[:, None]}, "omega must be one-dimensional"),
        (
            {"omega": [*OMEGA[:3], np.nan]},
            "omega is nan at index 3",
        ),
        ({"inputs": {}}, "the spectrum has no inputs: give at least one signal."),
        ({"outputs": {}}, "the spectrum has no outputs: give at least one signal."),
        ({"inputs": {"u": [1, 2]}}, "omega has 4 values but u has 2: they must match."),
        (
            {"outputs": {"y": [1, 2, 3, np.inf]}},
            "y is inf+0j at index 3",
        ),
        (
            {"outputs": {"y": [1, 2, 3, 1e80]}},
            "y is 1e+80+0j at index 3: squares of such numbers",
        ),
        ({"input_changes": {"u": [[0.1], [np.nan]]}}, "input_changes is nan at index 1"),
        ({"input_changes": {"u": 0.5}}, "input_changes of u has shape (): give two rows"),
        ({"input_changes": {"u": np.zeros((3, 2))}}, "input_changes of u has shape (3, 2)"),
    ],
)
def test_what_is_no_spectrum_is_refused(changes, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        spectrum(**changes)


def test_rounding_of_frequencies_is_allowed():
    """A millionth of a line of the first, and of the frequency for the others."""
    assert len(spectrum(omega=OMEGA * (1 + 0.9e-6))) == 4
    assert len(spectrum(omega=OMEGA * (1 - 0.9e-6))) == 4


def test_numbers_and_names_make_the_checksum():
    known = spectrum(input_changes={"u": [[T], [0.5]]})
    assert (
        known.checksum
        == spectrum(input_changes={"u": [[T], [0.5]]}, name="another", source="file").checksum
    )
    others = [
        {"input_changes": {}},
        {"input_changes": {"u": [[T], [0.6]]}},
        {"step": 0.01},
        {"inputs": {"v": KNOWN["inputs"]["u"]}},
        {"outputs": {"z": KNOWN["outputs"]["y"]}},
        {"outputs": {"y": [4 + 2j, 1 - 1j, 0.3j, 0.2]}},
    ]
    sums = {spectrum(**{"input_changes": {"u": [[T], [0.5]]}} | each).checksum for each in others}
    assert len(sums | {known.checksum}) == 7
    assert [*known.signals] == ["u", "y"]
    assert not known.omega.flags.writeable
    assert not known.inputs["u"].flags.writeable
    assert (
        repr(known) == "<TransientSpectrum '', 4 frequencies, 1.698 to 15.28 rad/s, 3.7 s, u to y>"
    )
