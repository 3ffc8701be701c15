"""`greybox identify`: from a log to a model, and the single commands that do the same."""

import json
import shlex
from dataclasses import replace
from importlib.resources import files

import pytest
from command_line import run
from synthetic_logs import px4_flight

import greybox as gb
from greybox.cli.identify_command import commands
from greybox.problems import sitl_pitch

OWN = """
import greybox as gb


class Own(gb.TransferFunction):
    K = gb.Parameter(50, bounds=(1, 1000))
    a = gb.Parameter(1, bounds=(0, 100))

    def response(self, s, p):
        return p.K / (s * (s + p.a))
"""
LOG = str(files("greybox.problems") / "data" / "sitl_pitch.BIN")


def test_the_single_commands_give_the_same(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, _ = run(capsys, "identify", LOG, "--json")
    answer = json.loads(out)
    assert status == 0
    assert answer["files"] == ["sitl_pitch_response.csv", "sitl_pitch_fit.h5", "sitl_pitch.png"]
    assert (tmp_path / "sitl_pitch.png").read_bytes().startswith(b"\x89PNG")
    written = gb.read_response("sitl_pitch_response.csv"), gb.load("sitl_pitch_fit.h5")

    status, _, err = run(capsys, "identify", LOG)
    assert status == 2
    assert "sitl_pitch_response.csv exists: give another name, or --force" in err

    for line in answer["commands"]:
        words = shlex.split(line)
        assert words[0] == "greybox"
        assert run(capsys, *words[1:], *([] if words[1] == "inspect" else ["--force"]))[0] == 0, (
            line
        )
    again = gb.read_response("sitl_pitch_response.csv"), gb.load("sitl_pitch_fit.h5")
    assert again[0].checksum == written[0].checksum
    assert again[1].estimate == pytest.approx(written[1].estimate, rel=1e-9)
    assert again[1].standard_error == pytest.approx(written[1].standard_error, rel=1e-6)


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
        "3",
        "--out",
        "own",
    ]
    command += ["--structures", *structures]
    answer = json.loads(run(capsys, *command, "--json")[1])
    assert len(answer["measurement"]["omega"]) == 9
    assert answer["files"] == ["own_response.csv", "own_fit.h5", "own.png"]
    assert "--band 1.5 30.0" in answer["commands"][1]
    assert [(s["model"], s["free"]) for s in answer["structures"]] == [
        ("own.py:Own", []),
        ("tilt:Tilt", ["T_rotor", "T_delay"]),
    ]
    chosen = next(s["model"] for s in answer["structures"] if s["chosen"])
    assert f"--model {chosen} " in answer["commands"][2]
    status, _, err = run(capsys, *command, "--force", "--structures", "tilt:Tild")
    assert (status, "there is no model 'tilt:Tild'" in err) == (2, True)


def test_inspect_ends_with_the_command_to_type_next(capsys):
    assert run(capsys, "inspect", LOG)[1].endswith(f"next: greybox identify {LOG}\n")


def test_a_log_of_px4_from_response_to_model(capsys, tmp_path, monkeypatch):
    """A made ULog of sines in closed loop: gain, damping and lag are within three standard errors of the plant's."""
    pytest.importorskip("pyulog")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flight.ulg").write_bytes(px4_flight())
    status, out, _ = run(capsys, "identify", "flight.ulg", "--starts", "4", "--json")
    answer = json.loads(out)
    assert status == 0
    assert (answer["measurement"]["input"], answer["measurement"]["output"]) == ("u", "theta")
    assert answer["measurement"]["closed_loop"]
    response, fit = (shlex.split(line)[1:] for line in answer["commands"][1:])
    assert run(capsys, *response, "--force")[0] == 0
    alone = json.loads(run(capsys, *fit, "--force", "--json")[1])
    assert fit[2] == "rate:DampedAngle"
    for name, truth in (("K_phi", 60.0), ("a", 2.0), ("T_rotor", 0.05)):
        for found in (answer["fit"], alone):
            assert abs(found["estimate"][name] - truth) < 3 * found["standard_error"][name]


@pytest.fixture(scope="module")
def flown():
    return gb.identify(sitl_pitch.LOG)


def test_the_single_commands_say_what_was_chosen_and_stated(flown):
    found, measured, fitted = commands(flown, "sitl_pitch.BIN", "sitl_pitch", [])
    assert found == "greybox inspect sitl_pitch.BIN --announced SINE"
    assert measured == (
        "greybox response sitl_pitch.BIN --input u=RATE.POut --output theta=ATT.Pitch --announced SINE --out "
        "sitl_pitch_response.csv"
    )
    assert fitted == (
        "greybox fit --model rate:DampedAngle --data sitl_pitch_response.csv --criterion maximum-likelihood --starts "
        "20 --seed 0 --out sitl_pitch_fit.h5 --plot sitl_pitch.png"
    )
    stated = replace(
        flown.measurement.settings, announced="", fields={"omega": "W"}, setpoint="ATT.DesPitch", axis="pitch",
        tests="1-3", instrument="SIDD.Targ", rate=50.0, settle=1.0, period=20.0, points=30,
        band=(1.0, 8.5), whole=True,
    )  # fmt: skip
    other = replace(
        flown,
        measurement=replace(flown.measurement, settings=stated),
        chosen=flown.steps[3]._replace(through=("gyro-filter", "gyro-notch")),
        starts=3,
        seed=7,
    )
    finding = ["--fields", "omega=W", "--setpoint", "ATT.DesPitch"]
    found, measured, fitted = map(shlex.split, commands(other, "my flight.BIN", "mine", []))
    assert found == ["greybox", "inspect", "my flight.BIN", *finding]
    assert measured == [
        *(
            "greybox",
            "response",
            "my flight.BIN",
            "--input",
            "u=RATE.POut",
            "--output",
            "theta=ATT.Pitch",
            *finding,
        ),
        *"--axis pitch --tests 1-3 --instrument SIDD.Targ --rate 50.0 --settle 1.0 --period 20.0".split(),
        *"--points 30 --band 1.0 8.5 --whole --out mine_response.csv".split(),
    ]
    assert fitted == [
        *"greybox fit --model tilt:Tilt --data mine_response.csv --through gyro-filter gyro-notch".split(),
        *"--free T_rotor T_delay --criterion maximum-likelihood --starts 3 --seed 7 --out mine_fit.h5".split(),
        *("--plot", "mine.png"),
    ]
    assert [
        words.split()[1]
        for words in commands(replace(other, chosen=None), "log.BIN", "mine", ["time=t"])
    ] == [
        "inspect",
        "response",
    ]
