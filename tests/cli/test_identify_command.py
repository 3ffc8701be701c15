"""`greybox identify`: from a log to a model."""

import json
import shlex
from importlib.resources import files

import numpy as np
import pytest
from command_line import run
from scipy.signal import lfilter
from synthetic_logs import px4_flight

import greybox as gb

pytestmark = pytest.mark.usefixtures("undrawn")

OWN = """
import greybox as gb


class Own(gb.TransferFunction):
    K = gb.Parameter(50, bounds=(1, 1000))
    a = gb.Parameter(1, bounds=(0, 100))

    def response(self, s, p):
        return p.K / (s * (s + p.a))
"""
STRUCTURES = (
    "--structures",
    "rate:LaggedAngle",
    "rate:DampedAngle+T_rotor+T_delay",
    "tilt:Tilt+T_rotor+T_delay+a5",
)
LOG = str(files("greybox.problems") / "data" / "sitl_pitch.BIN")


@pytest.mark.usefixtures("undrawn")
def test_response_fit_and_figure_are_written(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    structure = ("--structures", "rate:DampedAngle", "--starts", "2")
    status, out, _ = run(capsys, "identify", LOG, *structure, "--json")
    answer = json.loads(out)
    assert status == 0
    assert answer["files"] == ["sitl_pitch_response.csv", "sitl_pitch_fit.h5", "sitl_pitch.png"]
    assert (tmp_path / "sitl_pitch.png").exists()
    omega = answer["measurements"][0]["omega"]
    assert gb.read_response("sitl_pitch_response.csv").omega == pytest.approx(omega)
    assert gb.load("sitl_pitch_fit.h5").estimate == pytest.approx(answer["fit"]["estimate"])
    following = shlex.join(["greybox", "margins", "sitl_pitch_fit.h5", "--log", LOG])
    assert answer["next"][-1] == following

    status, _, err = run(capsys, "identify", LOG)
    assert status == 2
    assert "sitl_pitch_response.csv exists: give another name, or --force" in err


def test_what_does_not_explain_the_data_is_a_failure(capsys, tmp_path, monkeypatch):
    """A lag alone is no model of an angle.

    The values are saved and marked, and the command fails.
    """
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lag.py").write_text(OWN.replace("(s * (s + p.a))", "(s + p.a)"))
    command = ("identify", LOG, "--structures", "lag.py:Own", "--starts", "2", "--json")
    status, out, _ = run(capsys, *command)
    answer = json.loads(out)
    assert status == 1
    assert answer["explains"] is False
    assert "No structure explains the data" in answer["error"]
    assert any("does not explain the data" in text for text in answer["fit"]["warnings"])


@pytest.mark.usefixtures("undrawn")
def test_a_choice_is_an_option(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)
    structures = ["own.py:Own", "tilt:Tilt+T_rotor+T_delay"]
    command = [
        "identify",
        LOG,
        "--setpoint",
        "ATT.DesPitch",
        "--band",
        "1.5",
        "30",
        "--starts",
        "2",
        "--out",
        "own",
    ]
    command += ["--structures", *structures]
    answer = json.loads(run(capsys, *command, "--json")[1])
    assert len(answer["measurements"][0]["omega"]) == 9
    assert answer["files"] == ["own_response.csv", "own_fit.h5", "own.png"]
    assert [s["model"] for s in answer["structures"]] == ["own.py:Own", "tilt:Tilt"]
    assert {"T_rotor", "T_delay"} <= set(answer["structures"][1]["free"])
    status, _, err = run(capsys, *command, "--force", "--structures", "tilt:Tild")
    assert (status, "there is no model 'tilt:Tild'" in err) == (2, True)


def test_inspect_ends_with_the_command_to_type_next(capsys):
    following = shlex.join(["greybox", "identify", LOG])
    assert run(capsys, "inspect", LOG)[1].endswith(f"next: {following}\n")


@pytest.mark.usefixtures("undrawn")
def test_a_log_of_px4_from_response_to_model(capsys, tmp_path, monkeypatch):
    """A made ULog of sines in closed loop.

    Gain, damping and lag are within three standard errors of the plant's.
    """
    pytest.importorskip("pyulog")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flight.ulg").write_bytes(px4_flight())
    status, out, _ = run(capsys, "identify", "flight.ulg", *STRUCTURES, "--starts", "2", "--json")
    answer = json.loads(out)
    assert status == 0
    assert (answer["measurements"][0]["input"], answer["measurements"][0]["output"]) == (
        "u",
        "theta",
    )
    assert answer["measurements"][0]["closed_loop"]
    (chosen,) = (s["model"] for s in answer["structures"] if s["chosen"])
    assert chosen == "rate:DampedAngle"
    assert answer["next"][0] == "greybox report flight_fit.h5"
    for name, truth in (("K_phi", 60.0), ("a", 2.0), ("T_rotor", 0.05)):
        fit = answer["fit"]
        assert abs(fit["estimate"][name] - truth) < 3 * fit["standard_error"][name]


STAGED = """
import greybox as gb
from greybox.workflows.identification.stages import Stage


class Lag(gb.StateSpace):
    states = ("x",)
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s")
    K = gb.Parameter(1.5, bounds=(0.1, 9))

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.x) / p.T,)

    def output(self, x, u, p):
        return (x.x,)

    def stages(self, recordings):
        record = next(iter(recordings[0].values()))
        return (
            Stage("alone", "with a known gain.", lambda fits: gb.Problem(self, record, fixed={"K": 2.0})),
            Stage("both", "from there.", lambda fits: gb.Problem(self, record), lambda fits: [{"T": fits["alone"].estimate["T"]}]),
        )
"""


def test_a_structure_with_stages_is_fitted_to_the_record(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "staged.py").write_text(STAGED, encoding="utf-8")
    record = gb.Record(np.arange(0, 10, 0.05), {"u": np.sign(np.sin(np.arange(0, 10, 0.05)))})
    x = lfilter([0.1], [1, -0.95], record["u"])  # 20 samples of 0.05 s, and a gain of 2
    noise = np.random.default_rng(0).normal(size=200)
    lines = [
        "time,u,y",
        *(
            f"{t:.2f},{u},{y}"
            for t, u, y in zip(record.time, record["u"], x + 0.05 * noise, strict=True)
        ),
    ]
    (tmp_path / "log.csv").write_text("\n".join(lines), encoding="utf-8")
    structure = ("--structures", "staged.py:Lag")
    status, out, _ = run(capsys, "identify", "log.csv", *structure, "--json")
    answer = json.loads(out)
    assert status == 0
    assert answer["files"] == ["log_fit.h5"]
    assert answer["stages"]["alone"]["estimate"]["K"] == 2.0
    both = answer["stages"]["both"]
    assert both["estimate"]["K"] == pytest.approx(2.0, abs=4 * both["standard_error"]["K"])
    assert both["estimate"]["T"] == pytest.approx(1.0, rel=0.1)
    assert gb.load("log_fit.h5", models=[]).estimate["T"] == both["estimate"]["T"]

    status, _, err = run(capsys, "identify", "log.csv", *structure, "tilt:Tilt", "--force")
    assert status == 2
    assert "give it as the only structure" in err
