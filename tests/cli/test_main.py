"""The command line, run as a user runs it: usage, errors, exit statuses."""

import json
import sys

import pytest
from command_line import OWN, refused, run

from greybox.cli import output
from greybox.cli.output import BAD_INPUT, FAILED, USABLE, write_answer


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fit", "pitch_hoover"], "did you mean 'pitch_hover'"),
        (["fit", "no_such_thing_at_all"], "the included ones are"),
        (["fit", "missing.py"], "there is no file missing.py"),
        (["fit"], "give either a problem or --model"),
        (
            ["fit", "pitch_hover", "--model", "tilt:Tilt"],
            "give either a problem or --model",
        ),
        (["stepwise", "--candidates", "a5", "pitch_hover"], "a problem or"),
        (["compare", "--held-out", "a.csv", "a.h5"], "required: RESULT"),
        (["list", "tilt:Tilt", "yaw"], "unrecognized arguments: yaw"),
        (["fit", "--model", "tilt:Tilt"], "--model needs --data"),
        (["fit", "--model", "tilt:Tlit", "--data", "x.csv"], "tilt has Tilt"),
        (["fit", "--model", "tilt:Tilt", "--data", "x.csv"], "there is no file x.csv"),
        (["fit", "pitch_hover", "--data", "x.csv"], "--data goes with --model"),
        (["fit", "pitch_hover", "--starts", "0"], "'0' is not an integer of at least 1"),
        (["fit", "pitch_hover", "--starts", "many"], "'many' is not an integer"),
        (["fit", "pitch_hover", "--seed", "-1"], "--seed"),
        (["fit", "pitch_hover", "--delay", "padé"], "use 'exact' or 'pade:n'"),
        (["fit", "pitch_hover", "--criterion", "best"], "it has relative-error"),
        (["fit", "pitch_hover", "--criterion", "maximum-likelihood"], "needs the variance"),
        (["fit", "pitch_hover", "--fix", "a5"], "write NAME=VALUE"),
        (["fit", "pitch_hover", "--fix", "a9=1"], "no parameter 'a9'"),
        (["fit", "pitch_hover", "--fix", "a5=nan"], "give a finite number"),
        (["fit", "pitch_hover", "--fix", "a5=-1"], "outside its bounds"),
        (["fit", "pitch_hover", "--out", "/no/such/folder/x.h5"], "does not exist"),
        (["fit", "pitch_hover", "--fast"], "--fast"),
        (["list", "tilt:Nothing"], "tilt has Tilt"),
        (["list", "tilt:Tlit"], "did you mean 'Tilt'?"),
        (
            ["refit"],
            "there is no 'refit'; there are inspect, identify, response, list,",
        ),
        (
            ["fit", "pitch_hover", "--stars", "5"],
            "unrecognized arguments: --stars 5, did you mean --starts?",
        ),
        (["fit", "pitch_hover", "--fix", "t_delay=0"], "did you mean 'T_delay'?"),
        (["fit", "pitch_hover", "--free", "T_dealy"], "did you mean 'T_delay'?"),
        (["fit", "pitch_hover", "--criterion", "relative-eror"], "did you mean 'relative-error'?"),
        (
            ["fit", "pitch_hover", "--out", "fit.csv"],
            "is not a known kind of saved fit: end it in .h5",
        ),
        (["fit", "pitch_hover", "--out", "fit"], "is not a known kind of saved fit: end it in .h5"),
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
        ("return gb.Problem(Lag(), data())", "return 7", "it must be, or return, a gb.Problem"),
        ("def problem", "def stuff", "define problem()"),
        ("def problem", "def stuff", "or give --model"),
        ("p.K / (p.T * s + 1)", "p.K / (p.tau * s + 1)", "has no 'tau'; it has K, T"),
        ("p.K / (p.T * s + 1)", "p.K / (p.T * undefined + 1)", "line 11: NameError"),
        ("p.K / (p.T * s + 1)", "p.K / 0 / (1 / 0)", "line 11: ValueError: a formula of 'own_"),
        (
            "gb.Parameter(1.0, bounds=(0, 10)",
            "gb.Parameter(1.0, bounds=(10, 0)",
            "line 7: ValueError: bounds (10, 0)",
        ),
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


def test_a_file_that_is_not_python_names_its_line_once(capsys, own):
    name = own("import greybox as gb\n\nclass Broken(gb.StateSpace:\n    pass\n")
    sentence = refused(capsys, "fit", name)
    assert sentence.endswith("line 3: invalid syntax.\n")
    assert sentence.count("line 3") == 1


def test_debug_shows_the_traceback(capsys):
    status, _, err = run(capsys, "fit", "pitch_hoover", "--debug")
    assert status == 2
    assert "Traceback" in err
    assert "Traceback" not in run(capsys, "fit", "pitch_hoover")[2]


def test_an_error_names_its_class_if_it_has_no_message_and_takes_one_line(capsys, own):
    first = "import greybox as gb\n"
    silent = own(OWN.replace(first, first + "raise RuntimeError\n", 1))
    assert refused(capsys, "fit", silent).endswith("line 2: RuntimeError: RuntimeError\n")

    lines = own(OWN.replace(first, first + "raise ValueError('first\\n  second')\n", 1))
    assert "ValueError: first second" in refused(capsys, "fit", lines)


def test_what_a_users_file_prints_stays_off_standard_output(capsys, own):
    status, out, err = run(
        capsys, "fit", own(OWN.replace("def data", "print('hello')\n\ndef data")), "--json"
    )
    assert status == 0
    assert "hello" in err
    json.loads(out)


@pytest.mark.parametrize(("status", "told"), [(USABLE, FAILED), (BAD_INPUT, BAD_INPUT), (130, 130)])
def test_an_answer_that_cannot_be_written_is_a_failure(capsys, monkeypatch, status, told):
    monkeypatch.setattr(
        output, "write", lambda text, stream: "disk full" if stream is sys.stdout else ""
    )
    assert write_answer({}, "an answer", False, status) == told
    monkeypatch.setattr(output, "write", lambda text, stream: "")
    assert write_answer({}, "an answer", False, status) == status
