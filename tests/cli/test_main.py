"""The command line, run as a user runs it."""

import json
import subprocess
import sys
from importlib.resources import files

import numpy as np
import pytest
from declared_models import Lag, measured

import greybox as gb
from greybox.cli.main import _with_criterion, main
from greybox.models.drag import Drag

QUICK = ["--starts", "8"]

OWN = '''import greybox as gb
import numpy as np

class Lag(gb.TransferFunction):
    r"""A lag with delay."""
    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0, 10), unit="1", about="gain")
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s", about="time constant")

    def response(self, s, p):
        return p.K / (p.T * s + 1)

def data():
    omega = np.array([0.5, 1.0, 2.0, 4.0, 8.0])
    return gb.FrequencyResponse(omega, 3 / (0.2j * omega + 1))

def problem():
    return gb.Problem(Lag(), data())

def other():
    return gb.Problem(Lag(), data(), fixed={"T": 0.2})

settings = {"starts": 5, "seed": 3}
'''


RECORD = '''import greybox as gb
import numpy as np

class Lag(gb.StateSpace):
    r"""A lag."""
    states, inputs, outputs = ("y",), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(0, 10), unit="1", about="gain")
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s", about="time constant")

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.y) / p.T,)

    def output(self, x, u, p):
        return (x.y,)

def problem():
    time = np.arange(200) / 50
    u = np.sin(3 * time) + np.sin(7 * time)
    y = gb.simulate(Lag(), {"K": 2.0, "T": 0.3}, gb.Record(time, {"u": u}))["y"]
    noise = 0.02 * np.random.default_rng(0).normal(size=200)
    return gb.Problem(Lag(), gb.Record(time, {"u": u, "y": y + noise}, {"y": "m"}))

settings = {"starts": 3}
'''


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Write a user's own file, with a name that no other test used: Python keeps modules by name."""
    monkeypatch.chdir(tmp_path)
    own.number = getattr(own, "number", 0) + 1

    def write(text=OWN):
        path = tmp_path / f"own_{own.number}.py"
        path.write_text(text)
        return path.name

    yield write
    sys.modules.pop(f"own_{own.number}", None)


def run(capsys, *arguments):
    status = main([str(a) for a in arguments])
    return status, *capsys.readouterr()


def refused(capsys, *arguments):
    """Run a command that must be refused: one sentence on stderr, nothing on stdout, status 2."""
    status, out, err = run(capsys, *arguments)
    assert status == 2
    assert out == ""
    assert err.startswith("greybox: ")
    assert len(err.strip().splitlines()) == 1
    assert "Traceback" not in err
    return err


def test_the_main_job(capsys):
    status, out, _ = run(capsys, "fit", "pitch_hover", "--starts", "20")
    assert status == 0
    assert "0.559187" in out
    assert "angular acceleration per control" in out


def test_both_commands_are_the_same():
    command = [sys.executable, "-m", "greybox", "fit", "pitch_hover", "--starts", "8", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert json.loads(done.stdout)["cost"] == pytest.approx(0.559187, rel=1e-5)


def test_json_has_the_promised_keys_and_no_nan(capsys):
    status, out, _ = run(capsys, "fit", "yaw_hover", *QUICK, "--json")
    answer = json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} in JSON"))
    promised = (
        "problem criterion delay starts seed converged agreeing minima cost status estimate standard_error derived"
    )
    assert status == 0
    assert set(promised.split()) | {"warnings", "seconds", "versions"} <= set(answer)
    assert answer["problem"] == "yaw_hover"
    assert answer["starts"] == 8
    assert answer["estimate"]["T_rotor"] == 0.048
    assert any("a1_tilde" in warning for warning in answer["warnings"])


def test_unknown_is_null_in_json(capsys, own):
    text = OWN.replace("p.K / (p.T", "p.K / (1 + 0 * p.T) / (0.2")
    status, out, _ = run(capsys, "fit", own(text), "--json")
    answer = json.loads(out)
    assert status == 0
    assert answer["standard_error"]["T"] is None
    assert any(w.startswith("T is not determined") for w in answer["warnings"])


def test_list_names_every_shipped_problem_and_model(capsys):
    status, out, _ = run(capsys, "list")
    assert status == 0
    for name in ("pitch_hover", "rotors", "tilt:Tilt", "yaw:YawStates", "rigid_body:RigidBody"):
        assert name in out
    answer = json.loads(run(capsys, "list", "--json")[1])
    assert all("$$" in model["about"] and model["source"] for model in answer["models"])
    assert all(problem["source"] for problem in answer["problems"])
    assert "Source: S. Butterworth, On the theory of filter amplifiers" in out


@pytest.mark.parametrize("name", ["tilt:Tilt", "pitch_hover", "polynomial:Polynomial(3, 1)"])
def test_list_shows_one_whole(capsys, name):
    status, out, _ = run(capsys, "list", name)
    assert status == 0
    assert "$$" in out
    assert "meaning" in out


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
    (tmp_path / "response.csv").write_text("omega_rad_s,alpha,beta\n1,2.8846153846,-0.5769230769\n5,1.5,-1.5\n")
    status, out, _ = run(capsys, "fit", "--model", f"{name}:Lag", "--data", "response.csv", "--json", *QUICK)
    assert status == 0
    assert json.loads(out)["estimate"] == pytest.approx({"K": 3.0, "T": 0.2}, rel=1e-6)
    fixed = ["--fix", "T=0.3", "--json", *QUICK]
    answer = json.loads(run(capsys, "fit", "--model", f"{name}:Lag", "--data", "response.csv", *fixed)[1])
    assert answer["estimate"]["T"] == 0.3


def test_shipped_model_with_freed_and_fixed_parameters(capsys, tmp_path):
    table = (files("greybox.problems") / "data" / "table_4_3.csv").read_text().replace("pitch_", "")
    (tmp_path / "pitch.csv").write_text(table)
    command = ["fit", "--model", "tilt:Tilt", "--data", tmp_path / "pitch.csv", "--fix", "a5=0.2", "--free", "T_delay"]
    status, out, _ = run(capsys, *command, "--json", "--starts", "16")
    answer = json.loads(out)
    assert status == 0
    assert answer["estimate"]["a5"] == 0.2
    assert answer["estimate"]["T_delay"] != 0.0042


def test_fix_and_free_also_restate_a_problem(capsys):
    out = run(capsys, "fit", "pitch_hover", "--fix", "a5=0.3", "--free", "T_rotor", "--json", "--starts", "16")[1]
    answer = json.loads(out)
    assert answer["estimate"]["a5"] == 0.3
    assert answer["standard_error"]["T_rotor"] > 0


def test_delay_and_criterion(capsys):
    options = ["--delay", "pade:2", "--criterion", "squared-relative-error", "--json", *QUICK]
    answer = json.loads(run(capsys, "fit", "pitch_hover", *options)[1])
    assert answer["delay"] == "pade:2"
    assert answer["criterion"] == "squared-relative-error"
    assert answer["costs"]["squared-relative-error"] == pytest.approx(answer["cost"])


def test_out_and_plot_are_written_and_kept(capsys, tmp_path):
    import greybox as gb

    saved, drawn = tmp_path / "pitch.h5", tmp_path / "pitch.png"
    command = ["fit", "pitch_hover", *QUICK, "--out", saved, "--plot", drawn]
    status, out, _ = run(capsys, *command)
    assert status == 0
    assert str(saved) in out
    assert gb.load(saved).cost == pytest.approx(0.559187, rel=1e-5)
    assert drawn.read_bytes().startswith(b"\x89PNG")
    before = saved.read_bytes()
    assert "--force" in refused(capsys, *command)
    assert saved.read_bytes() == before
    assert run(capsys, *command, "--force")[0] == 0


def test_nothing_is_written_when_the_input_is_bad(capsys, tmp_path):
    refused(capsys, "fit", "pitch_hover", "--out", tmp_path / "x.h5", "--delay", "pade:0")
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_fails_has_status_1_and_its_reason(capsys, own):
    text = OWN.replace("p.K / (p.T * s + 1)", "p.K / (p.T * s + 1) / gb.sqrt(-1 - p.T)")
    status, out, err = run(capsys, "fit", own(text), "--json")
    answer = json.loads(out)
    assert status == 1
    assert "Invalid_Number_Detected" in answer["error"]
    assert "Invalid_Number_Detected" in err
    assert answer["cost"] is None
    assert answer["estimate"] == {"K": None, "T": None}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fit", "pitch_hoover"], "did you mean 'pitch_hover'"),
        (["fit", "no_such_thing_at_all"], "the shipped ones are"),
        (["fit", "missing.py"], "there is no file missing.py"),
        (["fit"], "give either a PROBLEM or --model"),
        (["fit", "pitch_hover", "--model", "tilt:Tilt"], "give either a PROBLEM or --model"),
        (["fit", "--model", "tilt:Tilt"], "--model needs --data"),
        (["fit", "--model", "tilt:Tlit", "--data", "x.csv"], "tilt has Tilt"),
        (["fit", "--model", "tilt:Tilt", "--data", "x.csv"], "there is no file x.csv"),
        (["fit", "pitch_hover", "--data", "x.csv"], "--data goes with --model"),
        (["fit", "pitch_hover", "--starts", "0"], "'0' is not a whole number of at least 1"),
        (["fit", "pitch_hover", "--starts", "many"], "'many' is not a whole number"),
        (["fit", "pitch_hover", "--seed", "-1"], "--seed"),
        (["fit", "pitch_hover", "--delay", "padé"], "use 'exact' or 'pade:n'"),
        (["fit", "pitch_hover", "--criterion", "best"], "use relative-error"),
        (["fit", "pitch_hover", "--criterion", "maximum-likelihood"], "needs the variance"),
        (["fit", "pitch_hover", "--fix", "a5"], "write NAME=VALUE"),
        (["fit", "pitch_hover", "--fix", "a9=1"], "no parameter 'a9'"),
        (["fit", "pitch_hover", "--fix", "a5=nan"], "give a finite number"),
        (["fit", "pitch_hover", "--fix", "a5=-1"], "outside its bounds"),
        (["fit", "pitch_hover", "--out", "/no/such/folder/x.h5"], "does not exist"),
        (["fit", "pitch_hover", "--fast"], "--fast"),
        (["list", "tilt:Nothing"], "tilt has Tilt"),
        (["refit"], "refit"),
        ([], "COMMAND"),
    ],
)
def test_bad_usage_is_one_sentence(capsys, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert words in refused(capsys, *arguments)
    assert list(tmp_path.iterdir()) == []


def test_errors_are_json_too(capsys):
    status, out, _ = run(capsys, "fit", "pitch_hoover", "--json")
    assert status == 2
    assert "did you mean" in json.loads(out)["error"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("def problem", "raise RuntimeError('boom')\n\ndef problem", "line 17: RuntimeError: boom"),
        ("return gb.Problem(Lag(), data())", "return 1 / 0", "ZeroDivisionError: division by zero"),
        ("import greybox as gb", "import greybox as gb\nx = (", "line 2: '(' was never closed"),
        ("return gb.Problem(Lag(), data())", "return 7", "it must give a gb.Problem"),
        ("def problem", "def stuff", "define problem()"),
        ("p.K / (p.T * s + 1)", "p.K / (p.tau * s + 1)", "has no 'tau'; it has K, T"),
        ("p.K / (p.T * s + 1)", "p.K / (p.T * undefined + 1)", "line 11: NameError"),
        ("gb.Parameter(1.0, bounds=(0, 10)", "gb.Parameter(1.0, bounds=(10, 0)", "line 7: ValueError: bounds (10, 0)"),
        (
            "gb.Parameter(1.0, bounds=(0, 10)",
            "gb.Parameter(11.0, bounds=(0, 10)",
            "start 11 lies outside bounds (0, 10)",
        ),
        ('"seed": 3', '"sede": 3', "'sede'"),
        ("import greybox as gb", "import greybox as gb, sys\nsys.exit(3)", "sys.exit"),
    ],
)
def test_an_error_in_a_users_file_names_file_and_line(capsys, own, old, new, words):
    assert old in OWN
    name = own(OWN.replace(old, new, 1))
    sentence = refused(capsys, "fit", name)
    assert words in sentence


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


def test_debug_shows_the_traceback(capsys):
    status, _, err = run(capsys, "fit", "pitch_hoover", "--debug")
    assert status == 2
    assert "Traceback" in err


def test_what_a_users_file_prints_stays_off_standard_output(capsys, own):
    status, out, err = run(capsys, "fit", own(OWN.replace("def data", "print('hello')\n\ndef data")), "--json")
    assert status == 0
    assert "hello" in err
    json.loads(out)


def test_a_stored_result_of_a_users_model_loads_without_it(capsys, own, tmp_path):
    name = own()
    assert run(capsys, "fit", name, "--out", tmp_path / "own.h5")[0] == 0
    code = (
        "import greybox as gb, os, sys\n"
        "fit = gb.load('own.h5')\n"
        "print(fit)\n"
        "gb.plot(fit)\n"
        "try:\n    print(fit.response([1.0]))\n"
        "except LookupError as error:\n    print('MISSING', error)\n"
    )
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "own.h5").write_bytes((tmp_path / "own.h5").read_bytes())
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path / "elsewhere", capture_output=True, text=True, check=True)
    assert "time constant" in done.stdout
    assert "MISSING the model Lag of the module" in done.stdout
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "MISSING" not in done.stdout


def test_a_problem_with_a_record(own, capsys):
    path = own(RECORD)
    status, out, err = run(capsys, "fit", path, "--json", "--out", "fit.h5")
    answer = json.loads(out)
    assert (status, err) == (0, "")
    assert abs(answer["estimate"]["T"] - 0.3) < 4 * answer["standard_error"]["T"]
    (output,) = answer["outputs"]
    assert (output["output"], output["unit"]) == ("y", "m")
    assert output["fit_percent"] > 95
    assert 0.017 < output["noise"] < 0.023
    status, out, _ = run(capsys, "fit", path, "--fix", "T=0.3")
    assert status == 0
    assert "200 samples in 1 record" in out
    assert "time constant" in out


def test_a_record_that_does_not_fit_the_command(own, capsys):
    path = own(RECORD)
    message = refused(capsys, "fit", path, "--criterion", "relative-error")
    assert "--criterion relative-error is for frequency responses and" in message
    assert "use output-error, prediction-error, or leave it out" in message
    assert "--criterion output-error is for records" in refused(
        capsys, "fit", "pitch_hover", "--criterion", "output-error"
    )
    assert "no parameter 'mass'" in refused(capsys, "fit", path, "--fix", "mass=1")


def test_a_criterion_in_time_is_named_like_the_others(own, capsys):
    path = own(RECORD)
    for name in ("output-error", "prediction-error"):
        answer = json.loads(run(capsys, "fit", path, "--criterion", name, "--json", "--starts", "2")[1])
        assert answer["criterion"] == name
        assert (answer["status"], answer["costs"]) == ("converged", {})


def test_what_else_a_problem_says_of_its_records_stays_with_another_criterion():
    rule = gb.OutputError(noise="full", inputs="held", biases=("y",))
    record = gb.Record(np.arange(9.0), {"u": np.arange(9.0), "y": np.arange(9.0)})
    problem = gb.Problem(Lag(), record, rule) + gb.Problem(Lag(), measured(Lag(), [1.0, 2.0]))
    found = _with_criterion(problem, gb.OutputError())
    assert [part.criterion for part in found.parts] == [rule, gb.RelativeError()]
    found = _with_criterion(problem, gb.MagnitudePhase())
    assert [part.criterion for part in found.parts] == [rule, gb.MagnitudePhase()]


def test_the_shipped_records(capsys):
    command = ["fit", "sitl_drag", "--starts", "2"]
    status, out, _ = run(capsys, *command)
    assert status == 0
    assert "7518 samples in 2 records" in out
    assert "v (sitl_drag_5deg): residual" in out
    answer = json.loads(run(capsys, *command, "--json")[1])
    assert answer["cost"] == pytest.approx(-14516.2355, abs=0.01)
    assert [output["part"] for output in answer["outputs"]] == ["sitl_drag_hover", "sitl_drag_5deg"]


def test_biases_of_records_are_fixed_by_their_names(capsys):
    fixed = ["--fix", "theta_bias_1=0.001", "C_x=0"]
    answer = json.loads(run(capsys, "fit", "sitl_drag", "--starts", "2", "--json", *fixed)[1])
    assert (answer["estimate"]["theta_bias_1"], answer["estimate"]["C_x"]) == (0.001, 0)
    assert answer["standard_error"]["theta_bias_1"] == 0
    assert answer["standard_error"]["theta_bias_2"] > 0
    sentence = refused(capsys, "fit", "sitl_drag", "--fix", "theta_bias=0")
    assert "no parameter 'theta_bias'; it has a5, C_x, theta_bias_1, theta_bias_2" in sentence


# --- records on the command line --------------------------------------------------------------------------------------

FLIGHT = files("greybox.problems") / "data" / "sitl_drag_hover.csv"
DRAG = ("fit", "--model", "drag:Drag", "--data")


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
        ("[rad]", "[deg]", "theta in deg, and a fit takes rad: make the record with gb.prepare(gb.read("),
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


def test_words_of_a_response_are_refused_for_a_record(capsys):
    for more in (("--input", "theta"), ("--output", "v"), ("--at", "v=1")):
        assert f"{more[0]} is for a frequency response, and {FLIGHT} is a record" in refused(
            capsys, *DRAG, FLIGHT, *more
        )
    sentence = refused(capsys, "fit", "sitl_drag", "--criterion", "relative-error")
    assert "--criterion relative-error is for frequency responses and sitl_drag has none" in sentence


def test_data_or_a_model_in_the_place_of_a_problem(capsys):
    assert f"--model tilt:Tilt --data {FLIGHT}" in refused(capsys, "fit", FLIGHT)
    assert "write --model drag:Drag --data FILE" in refused(capsys, "fit", "drag:Drag")
    assert "write --model drag:CLASS --data FILE" in refused(capsys, "fit", "drag")
