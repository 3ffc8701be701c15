"""The spectrum of one manoeuvre of a log, with what was chosen."""

import numpy as np
import pytest

from greybox.data.record import Record, Recording
from greybox.identification.manoeuvre import measure_manoeuvre
from greybox.spectral.transients import HIGHEST

TIME = np.arange(0, 40, 0.02)


def pulses(start, *durations):
    """Pulses of 0.1 with alternating signs."""
    edges = start + np.cumsum([0.0, *durations])
    signs = np.array([0.0, *(0.1 * (-1) ** np.arange(len(durations))), 0.0])
    return signs[np.searchsorted(edges, TIME + 1e-9)]


def flown(hold=None, **more):
    """A 2-1-1 at 5 s and a doublet at 30 s, of a first-order lag."""
    u = pulses(5.0, 2.0, 1.0, 1.0) + pulses(30.0, 1.0, 1.0)
    q = np.zeros(TIME.size)
    for k in range(TIME.size - 1):
        q[k + 1] = 0.98 * q[k] + 0.02 * u[k]
    return Recording({"FLY": Record(TIME, {"u": u, "q": q} | more, hold=hold or {})}, "made.csv")


def test_a_manoeuvre_is_cut_with_what_comes_before_and_after():
    found = measure_manoeuvre(flown({"u": 0.0, "q": 0.0}), ["FLY.u"], ["FLY.q"], "2-1-1")
    assert [m.kind for m in found.manoeuvres] == ["2-1-1", "doublet"]
    chosen = found.manoeuvre
    # Half a second before; after, the answer for as long as it lasted.
    assert found.record.time[0] == pytest.approx(chosen.start - 0.5, abs=0.021)
    assert found.record.time[-1] == pytest.approx(chosen.end + chosen.duration, abs=0.021)
    omega = found.spectrum.omega
    assert omega[0] == pytest.approx(2 * np.pi / (found.record.time[-1] - found.record.time[0]))
    assert chosen.band[1] - omega[0] < omega[-1] <= chosen.band[1]
    name = f"2-1-1 of u at {chosen.start:.4g} s"
    assert (found.spectrum.name, found.spectrum.source) == (name, "made.csv")
    assert found.choices == (
        f"from {found.record.time[0]:.2f} to {found.record.time[-1]:.2f} s, including the response after the input.",
        f"band up to {omega[-1]:.4g} rad/s, where the input fades; band=... chooses another.",
    )
    said = f"{name}: u -> q, {len(omega)} lines from {omega[0]:.4g} to {omega[-1]:.4g} rad/s"
    assert str(found).endswith("\n".join(["", said, *found.choices]))
    assert repr(found) == f"<ManoeuvreMeasurement 2-1-1, {chosen.start:.6g} s, {len(omega)} lines>"


def test_a_stated_band_and_a_control_of_which_nothing_is_known():
    found = measure_manoeuvre(flown(), ["FLY.u"], ["FLY.q"], "2", band=(1.0, 7.0))
    assert found.manoeuvre.kind == "doublet"
    # Two seconds after a shorter one.
    assert found.record.time[-1] == pytest.approx(
        found.manoeuvre.end + max(2.0, found.manoeuvre.duration), abs=0.021
    )
    assert 1.0 <= found.spectrum.omega[0] < 3.0
    assert 5.0 < found.spectrum.omega[-1] <= 7.0
    assert found.choices[1:] == (
        "u is taken as linear between samples, as its hold is unknown: give held=u if it keeps its values, which makes "
        "delays 10 ms shorter.",
    )
    held = measure_manoeuvre(flown(), ["FLY.u"], ["FLY.q"], "2", band=(1.0, 7.0), held=["u"])
    assert len(held.choices) == 1


def test_the_answer_ends_where_the_next_manoeuvre_begins():
    u = pulses(5.0, 2.0, 1.0, 1.0) + pulses(12.0, 1.0, 1.0)
    log = Recording({"FLY": Record(TIME, {"u": u, "q": np.cumsum(u)})}, "made.csv")
    found = measure_manoeuvre(log, ["FLY.u"], ["FLY.q"], "1")
    assert [m.kind for m in found.manoeuvres] == ["2-1-1", "doublet"]
    assert found.record.time[-1] == pytest.approx(found.manoeuvres[1].start, abs=0.021)


def test_a_manoeuvre_in_a_loop_is_told_and_one_that_is_not_there():
    r = pulses(5.0, 2.0, 1.0, 1.0)
    looped = flown({"u": 0.0}, r=r)
    found = measure_manoeuvre(looped, ["FLY.u"], ["FLY.q"], "1", setpoint="FLY.r")
    assert found.manoeuvre.axis == "FLY.r"
    assert found.choices[-1].startswith("closed loop (r is in the log)")
    assert "biased" in found.choices[-1]
    still = Recording({"FLY": flown()["FLY"].with_signals(u=0 * TIME)}, "made.csv")
    with pytest.raises(
        ValueError,
        match=r"no manoeuvre was found in FLY\.u: give setpoint=SIGNAL",
    ):
        measure_manoeuvre(still, ["FLY.u"], ["FLY.q"], "1")
    with pytest.raises(ValueError, match=r"no manoeuvre was found in FLY\.q: give"):
        measure_manoeuvre(
            Recording({"FLY": still["FLY"].with_signals(q=0 * TIME)}),
            ["FLY.u"],
            [],
            "1",
            setpoint="FLY.q",
        )


def test_no_frequency_above_that_which_the_rate_resolves_is_taken():
    """Two fifths of the sampling rate, where a pulse of one second has energy beyond."""
    found = measure_manoeuvre(flown(), ["FLY.u"], ["FLY.q"], "2", rate=2.5)
    omega, highest = found.spectrum.omega, HIGHEST * 2 * np.pi * 2.5
    assert found.manoeuvre.band[1] > highest
    assert highest - 2 * (omega[1] - omega[0]) < omega[-1] <= highest
