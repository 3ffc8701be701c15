"""What loggers do to samples is named, and right signals are left alone."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

import greybox as gb
from greybox.data.record import Recording
from greybox.data.signal_faults import record_faults, signal_faults

RATE, COUNT = 100.0, 6000


def motion(seed, noise=0.01, drive="noise"):
    """An input, and the second-order lag of it with noise of a sensor."""
    random = np.random.default_rng(seed)
    time = np.arange(COUNT) / RATE
    if drive == "noise":
        u = lfilter(*butter(2, 0.16), random.normal(size=COUNT))
    elif drive == "sweep":
        u = np.sin(2 * np.pi * (0.2 * time + 0.03 * time**2))
    elif drive == "binary":
        u = np.repeat(random.choice([-1.0, 1.0], COUNT // 10), 10)
    elif drive == "3-2-1-1":
        u = np.zeros(COUNT)
        for begin, end, level in (
            (600, 960, 1),
            (960, 1200, -1),
            (1200, 1320, 1),
            (1320, 1440, -1),
        ):
            u[begin:end] = level
    elif drive == "levels":
        u = np.repeat(random.normal(size=COUNT // 20), 20)
    else:  # a controller that reaches its limit
        u = np.clip(1.3 * np.sin(3 * time) + 0.3 * random.normal(size=COUNT), -1, 1)
    y = lfilter(*butter(2, random.uniform(0.02, 0.2)), u)
    return u, y + noise * np.std(y) * random.normal(size=COUNT)


def damaged(kind, y):
    """The signal as the logger leaves it, and the name of what it did."""
    rows = np.arange(COUNT)
    result = y.copy()
    if kind == "held":
        return np.repeat(y[::5], 5)
    if kind == "held, on another clock":
        return y[(np.floor(rows / 5.3) * 5.3).astype(int)]
    if kind == "interpolated":
        return np.interp(rows, rows[::5], y[::5])
    if kind == "clipped":
        return np.clip(y, -0.5 * np.abs(y).max(), 0.5 * np.abs(y).max())
    if kind == "frozen":
        result[2000:2300] = result[2000]
    elif kind == "far off":
        result[COUNT // 2] = 10 * np.abs(y).max()
    else:
        result[::2] += 2 * np.std(y)
    return result


@pytest.mark.parametrize("drive", ["noise", "sweep"])
@pytest.mark.parametrize(
    "kind",
    [
        "held",
        "held, on another clock",
        "interpolated",
        "clipped",
        "frozen",
        "far off",
        "alternating",
    ],
)
def test_what_a_logger_did_is_named(kind, drive):
    for seed in range(6):
        u, y = motion(seed, (0.001, 0.02, 0.1)[seed % 3], drive)
        faults = signal_faults("y", damaged(kind, y), u[None])
        named = [fault.kind for fault in faults]
        assert named == [kind.partition(",")[0]]


@pytest.mark.parametrize("drive", ["noise", "sweep", "binary", "3-2-1-1", "levels", "a limit"])
def test_right_signals_are_left_alone(drive):
    """Noise from none to a fifth; rounded by a counter, a text or single precision."""
    for seed in range(12):
        u, y = motion(seed, (0, 0.001, 0.02, 0.2)[seed % 4], drive)
        step = (0, 1e-3, 0.02)[seed % 3] * np.ptp(y)
        y = np.round(y / step) * step if step else y.astype(np.float32).astype(float)
        record = gb.Record(np.arange(COUNT) / RATE, {"u": u, "y": y})
        assert record_faults(record, ["y"], ["u"]) == ()


@pytest.mark.parametrize("drive", ["noise", "binary"])
def test_a_clock_or_a_sign_that_changes_in_mid_record_is_named(drive):
    time = np.arange(COUNT) / RATE
    half = COUNT // 2
    for seed in range(4):
        u, y = motion(seed, 0.02, drive)
        late = np.r_[y[:half], y[half - 5 : -5]]
        (fault,) = record_faults(gb.Record(time, {"u": u, "y": late}), ["y"], ["u"])
        assert fault.kind == "later"
        assert "y is 0.05 s later from about" in str(fault)

        turned = np.r_[y[:half], -y[half:]]
        (fault,) = record_faults(gb.Record(time, {"u": u, "y": turned}), ["y"], ["u"])
        assert fault.kind == "reversed"


def test_a_plant_that_changes_is_no_jump_of_a_clock():
    """A mass that halves, and a second input that takes over."""
    time = np.arange(COUNT) / RATE
    half = COUNT // 2
    for seed in range(4):
        u, _ = motion(seed)
        noise = 0.01 * np.random.default_rng(seed).normal(size=COUNT)
        slow, fast = (lfilter(*butter(2, edge), u) for edge in (0.03, 0.12))
        y = np.r_[slow[:half], fast[half:]] + noise
        assert record_faults(gb.Record(time, {"u": u, "y": y}), ["y"], ["u"]) == ()
        other, _ = motion(seed + 100)
        y = lfilter(*butter(2, 0.1), np.r_[u[:half], other[half:]]) + noise
        assert record_faults(gb.Record(time, {"u": u, "y": y}), ["y"], ["u"]) == ()


def test_resampling_does_not_hide_it():
    """The names of a fault are those of the test; the log has 100 Hz, the measurement 50 Hz."""
    u, y = motion(3)
    time = np.arange(COUNT) / RATE
    held = damaged("held", y)
    log = Recording({"log": gb.Record(time, {"force": u, "angle": held})}, "log.csv")
    for rate in (None, 50.0):
        settings = gb.identification.Settings(
            "u=log.force", "y=log.angle", whole=True, open_loop=True, rate=rate
        )
        measured = gb.identification.measure(log, settings)
        assert "y changes only in every fifth row" in str(measured.quality)
        assert measured.response is None


def test_every_verb_says_it():
    u, y = motion(1)
    time = np.arange(COUNT) / RATE
    record = gb.Record(time, {"u": u, "y": damaged("held", y)}, hold={"u": 0.0})
    text = "y changes only in every fifth row: a slower log was repeated"
    response = gb.spectral.spectral_response(record, "u", "y", points=20)
    quality = gb.spectral.check(record, response, input="u", output="y")
    assert text in str(quality)
    assert "no problems" not in str(quality)

    class Lag(gb.TransferFunction):
        """A lag."""

        input, output = "u", "y"
        T = gb.Parameter(0.1, bounds=(0.01, 2), unit="s")

        def response(self, s, p):
            return 1 / (p.T * s + 1)

    fit = gb.fit(gb.Problem(Lag(), record), 1, progress=False)
    assert any(text in warning for warning in fit.warnings)


def test_a_hold_that_nothing_states_is_said():
    u, y = motion(2)
    record = gb.Record(np.arange(COUNT) / RATE, {"u": u, "y": y})
    said = str(gb.spectral.check(record, input="u", output="y"))
    assert "nothing states how u runs between its samples" in said
    assert "5 ms of the delay belong to the hold" in said
    stated = gb.Record(record.time, record.signals, hold={"u": np.inf})
    assert "nothing states" not in str(gb.spectral.check(stated, input="u", output="y"))
