"""`greybox predict`: a saved model tried on another log, as `gb.predict` does."""

import json

import numpy as np
import pytest
from command_line import refused, run

import greybox as gb
from greybox.models.polynomial import Polynomial


def flight(path, seed):
    """A table of a lag with noise, driven by random steps."""
    random = np.random.default_rng(seed)
    time = np.arange(0, 20, 0.02)
    u = np.repeat(random.normal(size=20), 50)
    record = gb.Record(time, {"stick": u})
    model = Polynomial(1, 0, input="stick", output="roll")
    y = gb.simulate(model, {"b0": 6.0, "a0": 3.0}, record)["roll"]
    y = y + 0.02 * random.normal(size=time.size)
    np.savetxt(
        path, np.column_stack([time, u, y]), delimiter=",", header="time,stick,gyro", comments=""
    )


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("predict")
    flight(folder / "first.csv", 0)
    flight(folder / "second.csv", 1)
    log = gb.read(folder / "first.csv")
    lag = Polynomial(1, 0, input="u", output="p")
    found = gb.identify(log, input="u=stick", output="p=gyro", whole=True, structures=[lag])
    gb.save(found.fit, folder / "fit.h5")
    return folder


def test_a_model_is_tried_on_another_log_by_the_signals_of_its_own(capsys, saved):
    status, out, _ = run(capsys, "predict", saved / "fit.h5", saved / "second.csv", "--json")
    answer = json.loads(out)
    assert status == 0
    assert answer["outputs"]["p"]["fit_percent"] > 80
    part = ("--between", "2", "12", "--horizon", "2", "--json")
    other = json.loads(run(capsys, "predict", saved / "fit.h5", saved / "second.csv", *part)[1])
    assert (other["windows"], other["horizon"]) == (4, pytest.approx(2.0))
    assert "p" in run(capsys, "predict", saved / "fit.h5", saved / "second.csv", *part[:-1])[1]


def test_signals_can_be_stated(capsys, saved, tmp_path):
    fit = gb.load(saved / "fit.h5")
    data = gb.FrequencyResponse(fit.responses[0].data.omega, fit.responses[0].data.response)
    gb.save(gb.fit(gb.Problem(Polynomial(1, 0), data), starts=1), tmp_path / "bare.h5")
    command = ("predict", tmp_path / "bare.h5", saved / "second.csv")
    assert "has no signals of its log" in refused(capsys, *command)
    status, out, _ = run(capsys, *command, "--signals", "u=stick", "y=gyro", "--json")
    assert status == 0
    assert json.loads(out)["outputs"]["y"]["fit_percent"] > 80


def test_a_sensor_that_never_changes_is_refused(capsys, saved, tmp_path):
    rows = np.loadtxt(saved / "second.csv", delimiter=",", skiprows=1)
    rows[:, 2] = 1.5
    path = tmp_path / "dead.csv"
    np.savetxt(path, rows, delimiter=",", header="time,stick,gyro", comments="")
    assert "never changes" in refused(capsys, "predict", saved / "fit.h5", path)


def test_a_table_is_predicted_at_its_own_rows(capsys, tmp_path):
    """Stamps at random times, two of which may be very close: as `gb.predict` does."""
    random = np.random.default_rng(3)
    time = np.sort(random.uniform(0, 20, 1000))
    u = np.interp(time, np.arange(21), random.normal(size=21))
    model = Polynomial(1, 0)
    record = gb.Record(time, {"u": u}, hold={"u": 0.0})
    y = gb.simulate(model, {"b0": 6.0, "a0": 3.0}, record)["y"]
    y = y + 0.02 * random.normal(size=time.size)
    path = tmp_path / "uneven.csv"
    table = np.column_stack([time, u, y])
    np.savetxt(path, table, delimiter=",", header="time [s],u [1 sampled],y", comments="")
    measured = gb.read(path)["uneven"]
    fit = gb.fit(gb.Problem(model, measured), starts=2, progress=False)
    gb.save(fit, tmp_path / "fit.h5")
    answer = json.loads(run(capsys, "predict", tmp_path / "fit.h5", path, "--json")[1])
    rms = gb.predict(fit, record=measured).rms("y")
    assert answer["outputs"]["y"]["rms"] == pytest.approx(rms)
    assert rms == pytest.approx(0.02, rel=0.1)
