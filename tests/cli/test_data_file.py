"""The file given with --data."""

import json
from importlib.resources import files

import pytest
from command_line import refused, run

import greybox as gb
from greybox.models.drag import Drag

FLIGHT = files("greybox.problems") / "data" / "sitl_drag_hover.csv"
DRAG = ("fit", "--model", "drag:Drag", "--data")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("omega_rad_s,alpha,beta\n1,2,nan\n", "response is"),
        ("omega_rad_s,alpha,beta\n1,2,x\n", "line 2: beta is 'x'"),
        ("omega_rad_s,alpha,beta\n1,0,0\n2,1,1\n", "zero at omega = 1"),
        ("omega_rad_s,alpha,beta\n-1,1,0\n", "above 0 rad/s"),
        ("omega_rad_s,alpha,beta\n1,1,0\n1,1,0\n", "repeated"),
        ("omega_rad_s,alpha,beta\n1,1\n", "2 cells"),
        ("omega_rad_s,alpha,beta\n", "empty"),
        ("omega,alpha,beta\n1,1,1\n", "no column 'omega_rad_s'"),
        ("", "no column 'omega_rad_s'"),
        ("omega_rad_s,alpha,beta,coherence\n1,1,1,1.5\n", "coherence is 1.5"),
    ],
)
def test_bad_data_files(capsys, tmp_path, table, words):
    path = tmp_path / "bad.csv"
    path.write_text(table)
    assert words in refused(capsys, "fit", "--model", "rotor:Rotor", "--data", path)


def test_a_table_of_a_record_is_fitted_with_a_model_alone(capsys):
    answer = json.loads(run(capsys, *DRAG, FLIGHT, "--starts", "2", "--json", "--fix", "C_x=0")[1])
    fit = gb.fit(gb.Problem(Drag(), gb.read(FLIGHT)["sitl_drag_hover"], fixed={"C_x": 0.0}), starts=2, progress=False)
    assert answer["outputs"][0]["output"] == "v"
    assert answer["cost"] == pytest.approx(fit.cost, rel=1e-9)
    assert answer["estimate"]["a5"] == pytest.approx(fit.estimate["a5"], rel=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "theta",
            "pitch",
            "no message with the signals of Drag (theta, v); it has data: pitch, v: make the record with",
        ),
        ("[rad]", "[deg]", "theta in deg, but a fit needs rad: make the record with gb.prepare(gb.read("),
        ("time [s]", "when", "neither a frequency response, with columns omega_rad_s, alpha, beta, nor a record"),
    ],
)
def test_a_table_that_is_no_record_of_the_model_is_a_sentence_with_the_way(capsys, tmp_path, old, new, words):
    path = tmp_path / "data.csv"
    path.write_text(FLIGHT.read_text().replace(old, new))
    sentence = refused(capsys, *DRAG, path)
    assert words in sentence
    assert "make the record" not in words or "my.py with a function problem()" in sentence


def test_a_log_with_many_messages_asks_for_a_problem_file(capsys):
    sentence = refused(capsys, *DRAG, files("greybox.problems") / "data" / "sitl_pitch.BIN")
    assert "no message with the signals of Drag (theta, v)" in sentence
    assert "for the command line do so in a file my.py with a function problem()" in sentence
    assert len(sentence) < 800
