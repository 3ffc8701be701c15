"""What loggers do to samples is named, and right signals are left alone."""

import itertools
import re

import numpy as np
import pytest
from scipy.signal import butter, freqz, lfilter

import greybox as gb
from greybox.cli.main import main
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


def test_a_clock_that_jumps_within_a_sweep_is_named():
    """Each frequency is excited once, so both sides share none; the right sweeps are above."""
    time = np.arange(COUNT) / RATE
    for seed, rows in itertools.product(range(4), (-10, 5, 10)):
        u, y = motion(seed, (0.001, 0.02)[seed % 2], "sweep")
        begin = 1500 + 500 * (seed % 3)
        late = np.r_[y[:begin], np.roll(y, rows)[begin:-10]]
        record = gb.Record(time[: late.size], {"u": u[: late.size], "y": late})
        (fault,) = record_faults(record, ["y"], ["u"])
        assert fault.kind == "later"
        word = "later" if rows > 0 else "earlier"
        shift, place = re.search(rf"y is (\S+) s {word} from about (\S+) s", str(fault)).groups()
        assert float(shift) == pytest.approx(abs(rows) / RATE, rel=0.3)
        assert float(place) == pytest.approx(begin / RATE, abs=1)


def test_a_sweep_in_wind_or_of_a_nonlinear_plant_is_no_jump_of_a_clock():
    for seed in range(4):
        random = np.random.default_rng(seed)
        u, y = motion(seed, 0.001, "sweep")
        wind = lfilter(*butter(1, 0.02), random.normal(size=COUNT))
        gusty = y + 0.5 * np.std(y) / np.std(wind) * wind
        stiff = y + 0.4 * np.abs(y) * y
        for output in (gusty, stiff):
            record = gb.Record(np.arange(COUNT) / RATE, {"u": u, "y": output})
            assert record_faults(record, ["y"], ["u"]) == ()


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


class Lag(gb.TransferFunction):
    """A lag."""

    input, output = "u", "y"
    T = gb.Parameter(0.1, bounds=(0.01, 2), unit="s")

    def response(self, s, p):
        return 1 / (p.T * s + 1)


def test_every_verb_says_it(tmp_path, capsys):
    u, y = motion(1)
    time = np.arange(COUNT) / RATE
    held = damaged("held", y)
    record = gb.Record(time, {"u": u, "y": held}, hold={"u": 0.0}, name="flight")
    text = "y changes only in every fifth row: a slower log was repeated"
    response = gb.spectral.spectral_response(record, "u", "y", points=20)
    assert text in str(response)
    quality = gb.spectral.check(record, response, input="u", output="y")
    assert text in str(quality)
    assert "no problems" not in str(quality)
    assert quality.refusals

    fit = gb.fit(gb.Problem(Lag(), record), 1, progress=False)
    assert any(text in warning for warning in fit.warnings)
    of_response = gb.fit(gb.Problem(Lag(), response), 1, progress=False)
    assert any(text in warning for warning in of_response.warnings)
    clean = gb.Problem(Lag(), record.with_signals(y=y))
    fits = [gb.fit(clean, starts, progress=False) for starts in (1, 2)]
    assert f"warning: in flight, {text}" in str(gb.compare(*fits, records=record))
    assert text not in str(gb.compare(*fits))

    path = tmp_path / "flight.csv"
    table = np.column_stack([time, u, held])
    np.savetxt(path, table, delimiter=",", header="time [s],u [1 sampled],y", comments="")
    assert main(["inspect", str(path)]) == 0
    assert text in capsys.readouterr().out


# Root mean squares of errors over the stated ones; whole responses are off by ten to a hundred.
@pytest.mark.parametrize(
    ("kind", "drive"),
    [
        ("clipped", "noise"),
        *itertools.product(["frozen", "far off", "interpolated", "none"], ["noise", "sweep"]),
    ],
)
def test_a_response_without_the_damaged_samples_has_the_errors_that_it_states(kind, drive):
    ratios = []
    for seed in range(3):
        random = np.random.default_rng(seed + 1000)
        u, _ = motion(seed, drive=drive)
        plant = butter(2, random.uniform(0.05, 0.2))
        y = lfilter(*plant, u)
        y = y + 0.01 * np.std(y) * random.normal(size=COUNT)
        damage = y if kind == "none" else damaged(kind, y)
        if kind == "clipped":
            top = np.quantile(np.abs(y), 0.98)
            damage = np.clip(y, -top, top)
        log = Recording(
            {"log": gb.Record(np.arange(COUNT) / RATE, {"u": u, "y": damage}, hold={"u": 0.0})}
        )
        settings = gb.identification.Settings(
            "u=log.u", "y=log.y", whole=True, open_loop=True, band=(1.5, 20)
        )
        measured = gb.identification.measure(log, settings)
        assert ("These samples were left out" in str(measured.quality)) == (kind != "none")
        assert len(measured.response) >= 5
        exact = freqz(*plant, measured.response.omega / RATE)[1]
        error = np.abs(measured.response.response - exact) ** 2
        ratios.append(np.mean(error / measured.response.variance))
    assert np.sqrt(np.mean(ratios)) < 2


def test_lines_between_samples_of_another_clock_leave_no_response():
    u, y = motion(0)
    rows = np.arange(COUNT)
    at = np.arange(0, COUNT - 1, 5.3)
    lines = np.interp(rows, at, np.interp(at, rows, y))
    log = Recording({"log": gb.Record(rows / RATE, {"u": u, "y": lines}, hold={"u": 0.0})})
    settings = gb.identification.Settings("u=log.u", "y=log.y", whole=True, open_loop=True)
    measured = gb.identification.measure(log, settings)
    assert measured.response is None
    assert "y runs in straight lines" in str(measured.quality)


def test_a_matrix_leaves_damaged_samples_out_or_is_refused():
    time = np.arange(COUNT) / RATE
    made = gb.experiment.multisine(1, 30, 10, RATE, signals=["u", "v"], periods=6)
    signals = {name: made[name][:COUNT] for name in ("u", "v")}
    y = lfilter(*butter(2, 0.1), signals["u"]) + lfilter(*butter(1, 0.1), signals["v"])
    y += 0.01 * np.std(y) * np.random.default_rng(0).normal(size=COUNT)

    def measured(output):
        record = gb.Record(time, {**signals, "y": output}, hold=dict.fromkeys(signals, 0.0))
        log = Recording({"log": record})
        return gb.identification.measure_matrix(log, ["log.u", "log.v"], ["log.y"], 10.0)

    clean, cured = measured(y), measured(damaged("far off", y))
    assert "These samples were left out" in str(cured)
    for before, after in zip(clean.responses, cured.responses, strict=True):
        np.testing.assert_allclose(after.response, before.response, rtol=0.02)
    with pytest.raises(ValueError, match="y changes only in every fifth row"):
        measured(damaged("held", y))


def test_an_input_that_repeats_may_be_of_a_slower_log():
    u, y = motion(4)
    record = gb.Record(np.arange(COUNT) / RATE, {"u": damaged("held", u), "y": y})
    said = str(gb.spectral.check(record, input="u", output="y"))
    assert "If it is no command that was held, u changes only in every fifth row" in said


def test_a_hold_that_nothing_states_is_said():
    u, y = motion(2)
    record = gb.Record(np.arange(COUNT) / RATE, {"u": u, "y": y})
    said = str(gb.spectral.check(record, input="u", output="y"))
    assert "nothing states how u runs between its samples" in said
    assert "5 ms of the delay belong to the hold" in said
    stated = gb.Record(record.time, record.signals, hold={"u": np.inf})
    assert "nothing states" not in str(gb.spectral.check(stated, input="u", output="y"))


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_every_lost_row_is_counted(share):
    u, y = motion(5)
    lost = np.random.default_rng(5).random(COUNT) < share
    lost[[0, -1]] = False
    record = gb.Record(
        np.flatnonzero(~lost) / RATE, {"u": u[~lost], "y": y[~lost]}, hold={"u": 0.0}
    )
    settings = gb.identification.Settings("u=log.u", "y=log.y", whole=True, open_loop=True)
    quality = str(gb.identification.measure(Recording({"log": record}), settings).quality)
    counts = re.findall(r"(\d+) (?:single|lost) rows?", quality)
    # Gaps of more than three rows are named by their length.
    runs = np.diff(np.flatnonzero(~lost)) - 1
    assert sum(map(int, counts)) == runs[runs <= 3].sum()
