"""Tables of other loggers on the command line: read right, or asked about.

Never a wrong number in silence.
"""

import json

import numpy as np
import pytest
from command_line import RECORD, run
from scipy.io import savemat

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

TIME = np.arange(300) / 50
U = np.sin(3 * TIME) + np.sin(7 * TIME)
LAG = """import greybox as gb

class Lag(gb.StateSpace):
    r"A lag."
    states, inputs, outputs = ("y",), ("u",), ("y",)
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s", about="time constant")

    def derivative(self, x, u, p):
        return ((u.u - x.y) / p.T,)

    def output(self, x, u, p):
        return (x.y,)

class Decay(gb.StateSpace):
    r"A lag without an input."
    states, inputs, outputs = ("y",), (), ("y",)
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s", about="time constant")
    c = gb.Parameter(0.0, bounds=(-1, 1), unit="1", about="rest")

    def derivative(self, x, u, p):
        return ((p.c - x.y) / p.T,)

    def output(self, x, u, p):
        return (x.y,)
"""


@pytest.fixture(scope="module")
def y():
    truth = gb.simulate(_lag(), {"K": 1.0, "T": 0.3}, gb.Record(TIME, {"u": U}))["y"]
    return truth + 0.01 * np.random.default_rng(0).standard_normal(TIME.size)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One folder for all tests: a Python file of one name is imported once."""
    path = tmp_path_factory.mktemp("tables")
    (path / "tables_my.py").write_text(LAG)
    return path


@pytest.fixture
def table(folder, monkeypatch, y):
    """Writes the table, its columns u, y and a time with these names, in these ticks."""
    monkeypatch.chdir(folder)

    def write(header, ticks=None, scale=1.0):
        times = [] if ticks is None else [[str(round(k)) for k in ticks]]
        columns = [*times, *([f"{v:.9g}" for v in values] for values in (U, scale * y))]
        rows = [",".join(row) for row in zip(*columns, strict=True)]
        (folder / "a.csv").write_text("\n".join([header, *rows]) + "\n")

    return write


def fitted(capsys, *words, data="a.csv"):
    status, out, error = run(
        capsys,
        "fit",
        "--model",
        "tables_my.py:Lag",
        "--data",
        data,
        *words,
        "--starts",
        "2",
        "--json",
    )
    answer = json.loads(out)
    assert status == 0, (answer, error)
    assert answer["estimate"]["T"] == pytest.approx(0.3, abs=0.01)
    return " ".join(answer["warnings"])


@pytest.mark.parametrize(
    ("header", "ticks", "words", "said"),
    [
        ("t,u,y", 1e3 * TIME, ["--columns", "time=t:ms"], ""),
        ("time,u,pos", 1e3 * TIME, ["--columns", "time=time:ms", "y=pos"], ""),
        ("%time,u,y", 1.7e18 + 1e9 * TIME, [], "ns since 1970"),
        ("timestamp,u,y", 1e8 + 1e6 * TIME, [], "taken for µs"),
        ("timestamp,u,y", 5e4 + 1e3 * TIME, [], "taken for ms"),
        ("u,y", None, ["--rate", "50"], ""),
    ],
)
def test_times_of_loggers(table, capsys, header, ticks, words, said):
    table(header, ticks)
    assert said in fitted(capsys, *words)


def test_units_of_the_header_are_converted_and_must_agree_with_the_stated_ones(table, capsys):
    table("time [ms],u [%],y [%]", 1e3 * TIME, scale=1.0)
    assert "cannot" not in fitted(capsys)
    status, _, error = run(
        capsys, "fit", "--model", "tables_my.py:Lag", "--data", "a.csv", "--columns", "y=y:deg"
    )
    assert status == 2
    assert "its unit is % in the table, not deg" in error


@pytest.mark.parametrize("ticks", [1e7 * TIME, None])
def test_what_is_no_plausible_time_is_asked_for(table, capsys, ticks):
    table("time,u,y" if ticks is not None else "u,y", ticks)
    status, _, error = run(capsys, "fit", "--model", "tables_my.py:Lag", "--data", "a.csv")
    assert status == 2
    assert "state its unit" in error if ticks is not None else "or a rate" in error


def test_a_rate_beside_a_time_is_refused(table, capsys):
    table("time [ms],u,y", 1e3 * TIME)
    words = ["fit", "--model", "tables_my.py:Lag", "--data", "a.csv", "--rate", "50"]
    status, _, error = run(capsys, *words)
    assert (status, "has a time column" in error) == (2, True)


@pytest.mark.parametrize("inside", [True, False])
def test_a_struct_with_a_sampling_interval(table, folder, capsys, y, inside):
    contents = {"u": U, "yaw": y, "Ts": 0.02}
    savemat(folder / "a.mat", {"data": contents} if inside else contents)
    fitted(capsys, "--columns", "y=yaw", data="a.mat")


def test_a_response_without_a_header_goes_by_numbers(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    omega = np.geomspace(0.5, 20, 12)
    lag = 2 / (0.3j * omega + 1)
    rows = np.c_[omega / (2 * np.pi), 20 * np.log10(np.abs(lag)), np.degrees(np.angle(lag))]
    np.savetxt("a.csv", rows, delimiter=",")
    words = ["--model", "polynomial:Polynomial(1, 0)", "--data", "a.csv", "--starts", "4", "--json"]
    columns = ["frequency=1:Hz", "magnitude=2:dB", "phase=3:deg"]
    status, out, _ = run(capsys, "fit", *words, "--columns", *columns)
    assert status == 0
    assert json.loads(out)["cost"] < 1e-6


@pytest.mark.parametrize("words", [["--input", "q"], ["--output", "q"]])
def test_names_that_do_not_fit_the_model_are_refused(table, folder, capsys, words):
    omega = np.geomspace(0.5, 20, 12)
    response = gb.FrequencyResponse(omega, 1 / (0.3j * omega + 1), "u", "y")
    gb.data.write_response(response, folder / "response.csv")
    command = ["fit", "--model", "tables_my.py:Lag", "--data", "response.csv", "--starts", "2"]
    assert run(capsys, *command, "--input", "u", "--output", "y")[0] == 0
    status, _, error = run(capsys, *command, *words)
    assert (status, f"has no {words[0][2:]} 'q'; it has" in error) == (2, True), error


def test_models_without_inputs_are_compared_and_reported(table, folder, capsys):
    table("t,u,y", 1e3 * TIME)
    rng = np.random.default_rng(1)
    for name in ("seen", "other"):
        decay = np.exp(-TIME / 0.7) + 0.01 * rng.standard_normal(TIME.size)
        rows = np.c_[1e3 * TIME, decay]
        np.savetxt(f"{name}.csv", rows, delimiter=",", header="tick,pos", comments="")
    names = ["--columns", "time=tick:ms", "y=pos"]
    data = ["--data", "seen.csv", *names, "--starts", "2"]
    for out, words in (("a.h5", ["--fix", "c=0"]), ("b.h5", [])):
        status, *_ = run(
            capsys, "fit", "--model", "tables_my.py:Decay", *data, *words, "--out", out
        )
        assert status == 0
    own = ["--model", "tables_my.py"]
    assert run(capsys, "compare", "a.h5", "b.h5", *own)[0] == 0
    assert run(capsys, "predict", "b.h5", "other.csv", *names, *own)[0] == 0
    words = ["report", "a.h5", "b.h5", "--held-out", "other.csv", *names, "--out", "a.html", *own]
    assert run(capsys, *words)[0] == 0
    assert "other" in (folder / "a.html").read_text()
    fit = gb.load("b.h5", models=["tables_my.py"])
    assert gb.predict(fit).outputs == ("y",)


def test_a_fit_is_saved_as_hdf5_alone(tmp_path):
    record = gb.FrequencyResponse([1.0, 2.0, 4.0], [1, 0.5, 0.2])
    fit = gb.fit(gb.Problem(_lag(), record), starts=2)
    for name in ("x.json", "x", "x.csv"):
        with pytest.raises(ValueError, match=r"ends in \.h5 or \.hdf5"):
            gb.save(fit, tmp_path / name)
    assert gb.fit(gb.Problem(_lag(), record), starts=[fit.estimate]).converged


def _lag():
    namespace = {}
    exec(RECORD, namespace)
    return namespace["Lag"]()


def test_what_long_steps_are_is_said_and_can_be_stated(table, folder, capsys):
    table("time [ms],u,y", 1e3 * TIME)
    lines = (folder / "a.csv").read_text().splitlines()
    (folder / "a.csv").write_text("\n".join(lines[:121] + lines[151:]) + "\n")  # 0.6 s are lost
    words = ["fit", "--model", "tables_my.py:Lag", "--data", "a.csv", "--json"]
    said = {}
    for gaps in ("", "bridge", "cut"):
        _, out, _ = run(capsys, *words, *(["--gaps", gaps] if gaps else []))
        (said[gaps],) = json.loads(out)["gaps"]
    assert [said[gaps]["stretches"] for gaps in said] == [2, 1, 2]
    assert "inputs are unknown at 1, where a new stretch begins" in said[""]["text"]
    assert "known there, as stated" in said["bridge"]["text"]
    assert "cut at 1 step longer than 1.5 median steps, as stated" in said["cut"]["text"]
    status, _, error = run(capsys, *words, "--gaps", "fill")
    assert (status, "fill" in error) == (2, True)
