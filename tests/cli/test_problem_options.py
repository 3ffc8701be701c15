"""The problem that the options of `greybox fit` state."""

import json
from importlib.resources import files

import numpy as np
import pytest
from command_line import QUICK, RECORD, refused, run
from declared_models import Lag, measured

import greybox as gb
from greybox.models.filters import LowPass
from greybox.models.tilt import LinearTilt, Tilt
from greybox.workflows.study.stated_problem import _with_criterion, filters_of, through

FLIGHT = files("greybox.problems") / "data" / "sitl_drag_hover.csv"
DRAG = ("fit", "--model", "drag:Drag", "--data")


def test_own_file_with_its_settings(capsys, own):
    name = own()
    status, out, _ = run(capsys, "fit", name, "--json")
    answer = json.loads(out)
    assert status == 0
    assert (answer["starts"], answer["seed"], answer["problem"]) == (5, 3, name.removesuffix(".py"))
    assert answer["estimate"] == pytest.approx({"K": 3.0, "T": 0.2}, rel=1e-6)
    answer = json.loads(run(capsys, "fit", f"{name}:other", "--json", "--starts", "3")[1])
    assert answer["starts"] == 3
    assert answer["estimate"]["T"] == 0.2


def test_own_model_and_own_data(capsys, own, tmp_path):
    name = own()
    (tmp_path / "response.csv").write_text(
        "omega_rad_s,alpha,beta\n1,2.8846153846,-0.5769230769\n5,1.5,-1.5\n"
    )
    status, out, _ = run(
        capsys, "fit", "--model", f"{name}:Lag", "--data", "response.csv", "--json", *QUICK
    )
    assert status == 0
    assert json.loads(out)["estimate"] == pytest.approx({"K": 3.0, "T": 0.2}, rel=1e-6)
    fixed = ["--fix", "T=0.3", "--json", *QUICK]
    answer = json.loads(
        run(capsys, "fit", "--model", f"{name}:Lag", "--data", "response.csv", *fixed)[1]
    )
    assert answer["estimate"]["T"] == 0.3


def test_shipped_model_with_freed_and_fixed_parameters(capsys, tmp_path):
    table = (files("greybox.problems") / "data" / "table_4_3.csv").read_text().replace("pitch_", "")
    (tmp_path / "pitch.csv").write_text(table)
    command = [
        "fit",
        "--model",
        "tilt:Tilt",
        "--data",
        tmp_path / "pitch.csv",
        "--fix",
        "a5=0.2",
        "--free",
        "T_delay",
    ]
    status, out, _ = run(capsys, *command, "--json", "--starts", "16")
    answer = json.loads(out)
    assert status == 0
    assert answer["estimate"]["a5"] == 0.2
    assert answer["estimate"]["T_delay"] != 0.0042


def test_fix_and_free_also_restate_a_problem(capsys):
    out = run(
        capsys,
        "fit",
        "pitch_hover",
        "--fix",
        "a5=0.3",
        "--free",
        "T_rotor",
        "--json",
        "--starts",
        "16",
    )[1]
    answer = json.loads(out)
    assert answer["estimate"]["a5"] == 0.3
    assert answer["standard_error"]["T_rotor"] > 0


def test_delay_and_criterion(capsys):
    options = ["--delay", "pade:2", "--criterion", "squared-relative-error", "--json", *QUICK]
    answer = json.loads(run(capsys, "fit", "pitch_hover", *options)[1])
    assert answer["delay"] == "pade:2"
    assert answer["criterion"] == "squared-relative-error"
    assert answer["costs"]["squared-relative-error"] == pytest.approx(answer["cost"])


def test_a_record_that_does_not_fit_the_command(own, capsys):
    path = own(RECORD)
    message = refused(capsys, "fit", path, "--criterion", "relative-error")
    assert "--criterion relative-error is for frequency responses and" in message
    assert "output-error, prediction-error" in message
    message = refused(capsys, "fit", "pitch_hover", "--criterion", "output-error")
    assert "--criterion output-error is for records" in message
    assert "magnitude-phase" in message
    assert "prediction-error" not in message
    assert "no parameter 'mass'" in refused(capsys, "fit", path, "--fix", "mass=1")


def test_a_criterion_in_time_is_named_like_the_others(own, capsys):
    path = own(RECORD)
    for name in ("output-error", "prediction-error"):
        answer = json.loads(
            run(capsys, "fit", path, "--criterion", name, "--json", "--starts", "2")[1]
        )
        assert answer["criterion"] == name
        assert (answer["status"], answer["costs"]) == ("converged", {})


def test_what_else_a_problem_says_of_its_records_stays_with_another_criterion():
    rule = gb.OutputError(noise="full", inputs="held", biases=("y",))
    record = gb.Record(np.arange(9.0), {"u": np.arange(9.0), "y": np.arange(9.0)})
    problem = gb.Problem(Lag(), record, rule) + gb.Problem(Lag(), measured(Lag(), [1.0, 2.0]))
    found = _with_criterion(problem, "output-error")
    assert [part.criterion for part in found.parts] == [rule, gb.RelativeLikelihood()]
    with pytest.raises(
        ValueError, match=r"costs of different criteria add only where both are likelihoods"
    ):
        _with_criterion(problem, "magnitude-phase")


@pytest.mark.usefixtures("unjudged")
def test_biases_of_records_are_fixed_by_their_names(capsys):
    fixed = ["--fix", "theta_bias_1=0.001", "C_x=0"]
    answer = json.loads(run(capsys, "fit", "sitl_drag", "--starts", "1", "--json", *fixed)[1])
    assert (answer["estimate"]["theta_bias_1"], answer["estimate"]["C_x"]) == (0.001, 0)
    assert answer["standard_error"]["theta_bias_1"] == 0
    assert answer["standard_error"]["theta_bias_2"] > 0
    sentence = refused(capsys, "fit", "sitl_drag", "--fix", "theta_bias=0")
    assert "no parameter 'theta_bias'; it has a5, C_x, theta_bias_1, theta_bias_2" in sentence


# --- records on the command line


def test_words_of_a_response_are_refused_for_a_record(capsys):
    for more in (("--input", "theta"), ("--output", "v")):
        assert f"{more[0]} {more[1]} is for a frequency response, and {FLIGHT} is " in refused(
            capsys, *DRAG, FLIGHT, *more
        )
    sentence = refused(capsys, *DRAG, FLIGHT, "--at", "v=1")
    assert "operating point of a frequency response and this is a record" in sentence
    sentence = refused(capsys, "fit", "sitl_drag", "--criterion", "relative-error")
    assert (
        "--criterion relative-error is for frequency responses and sitl_drag has none" in sentence
    )


def test_data_or_a_model_in_the_place_of_a_problem(capsys):
    assert f"--model tilt:Tilt --data {FLIGHT}" in refused(capsys, "fit", FLIGHT)
    assert "write --model drag:Drag --data FILE" in refused(capsys, "fit", "drag:Drag")
    assert "write --model drag:CLASS --data FILE" in refused(capsys, "fit", "drag")


def test_a_users_file_chooses_the_transcription_and_its_integrator(own, capsys):
    text = RECORD.replace(
        '"starts": 3', '"starts": 1, "method": gb.SingleShooting(integrator=gb.Radau())'
    ).replace("200", "60")
    assert run(capsys, "fit", own(text))[0] == 0


def test_unknown_settings_are_refused(own, capsys):
    path = own(RECORD.replace('"starts": 3', '"tries": 3'))
    assert "has no setting 'tries'; it has starts, seed, method" in refused(capsys, "fit", path)


def test_an_ode_is_behind_no_filter():
    with pytest.raises(
        ValueError, match=r"through=\.\.\. needs a transfer function, and LinearTilt is"
    ):
        through(LinearTilt(), Tilt())
    with pytest.raises(ValueError, match="through=tilt:LinearTilt is an ODE"):
        filters_of("tilt:LinearTilt", measured(Lag(), [1.0, 2.0]))
    assert through(Tilt(), LowPass(20, 0.71)).output == Tilt().output
