"""Tables whose columns have other names and units, and what is said of single parameters."""

import json

import numpy as np
import pytest
from command_line import OWN, QUICK, RECORD, refused, run

import greybox as gb
from greybox.cli.options import UsageError
from greybox.cli.study_file import read_study_file

HERTZ = np.array([0.1, 0.3, 0.9, 2.0])
RESPONSE = 3 / (0.2j * 2 * np.pi * HERTZ + 1)
TRUTH = {"K": 3.0, "T": 0.2}
POLAR = ["frequency=Freq", "magnitude=Mag:dB", "phase=Phase:deg"]


@pytest.fixture
def foreign(tmp_path):
    rows = zip(HERTZ, 20 * np.log10(abs(RESPONSE)), np.degrees(np.angle(RESPONSE)), strict=True)
    lines = ["Freq (Hz);Mag;Phase;Note", *(f"{f};{m};{p};" for f, m, p in rows)]
    (tmp_path / "foreign.csv").write_text("\n".join(lines))
    return "foreign.csv"


def answer(capsys, *arguments):
    status, out, err = run(capsys, "fit", *arguments, "--json")
    assert status == 0, err
    return json.loads(out)


def test_a_response_in_hertz_decibels_and_degrees(capsys, own, foreign):
    model = f"{own()}:Lag"
    said = answer(capsys, "--model", model, "--data", foreign, "--columns", *POLAR, *QUICK)
    assert said["estimate"] == pytest.approx(TRUTH, rel=1e-6)
    # A unit that is given goes before that in the header: the same numbers in rad/s are another
    # system.
    slow = ["frequency=Freq:rad/s", *POLAR[1:]]
    said = answer(capsys, "--model", model, "--data", foreign, "--columns", *slow, *QUICK)
    assert said["estimate"]["T"] == pytest.approx(0.2 * 2 * np.pi, rel=1e-6)


def test_a_record_in_milliseconds_and_degrees(capsys, own, tmp_path):
    model = f"{own(RECORD)}:Lag"
    time = np.arange(100) * 0.02
    y = np.radians(30) * (1 - np.exp(-time / 0.3))
    y += 0.005 * np.random.default_rng(0).normal(size=100)
    lines = [
        "ms,step,tilt (deg)",
        *(f"{1000 * t},1,{np.degrees(v)}" for t, v in zip(time, y, strict=True)),
    ]
    (tmp_path / "step.csv").write_text("\n".join(lines))
    columns = ["--columns", "time=ms:ms", "u=step", "y=tilt"]
    for method in ([], ["--method", "collocation"]):
        said = answer(
            capsys, "--model", model, "--data", "step.csv", *columns, *method, "--starts", "2"
        )
        assert said["estimate"] == pytest.approx({"K": np.radians(30), "T": 0.3}, rel=0.03)


def test_bounds_and_starts(capsys, own):
    name = own()
    said = answer(capsys, name, "--bounds", "K=0:2", "T=0.1:", *QUICK)
    assert said["bounds"] == {"K": [0, 2], "T": [0.1, None]}
    assert said["at_bound"] == ["K"]
    said = answer(capsys, name, "--start", "T=0.3", "--starts-box", "K=2:4", *QUICK)
    assert said["estimate"] == pytest.approx(TRUTH, rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["--columns", "frequency"],
            "--columns 'frequency' is not understood: write NAME=COLUMN",
        ),
        (
            ["--columns", "frequency=Freq", "frequency=Mag"],
            "--columns names frequency twice: Freq and Mag.",
        ),
        (
            ["--columns", *POLAR[:2]],
            "needs more than the columns frequency, magnitude for a frequency response",
        ),
        (
            ["--columns", *POLAR[:2], "phase=Phase"],
            "has the column 'Phase' without a unit: state deg or rad",
        ),
        (
            ["--columns", *POLAR[:2], "phase=Phse:deg"],
            "has no column 'Phse'; it has Freq [Hz], Mag, Phase",
        ),
        (
            ["--columns", "omega=Freq", *POLAR[1:]],
            "cannot have 'omega', which is not a column of a frequency response",
        ),
        (
            ["--columns", *POLAR, "gain=Mag"],
            "cannot have 'gain', which is not a column of a frequency response",
        ),
        (
            ["--columns", *POLAR[:2], "phase=Phase:dB"],
            "the unit of phase is 'dB': give 'deg' or 'rad'",
        ),
        (
            ["--columns", "u=Mag", "y=Note"],
            "foreign.csv has no numbers in the column 'Note': name another one",
        ),
        (["--columns", "u=Mag:furlong", "y=Phase"], "the unit 'furlong' is not known"),
        (
            ["--columns", *POLAR, "--method", "collocation"],
            "--method is for records and foreign has none",
        ),
        (
            ["--columns", *POLAR, "--bounds", "K=3"],
            "--bounds 'K=3' is not understood: write NAME=LOW:HIGH.",
        ),
        (["--columns", *POLAR, "--bounds", "b=0:3"], "foreign has no parameter 'b'; it has K, T"),
        (["--columns", *POLAR, "--bounds", "K=3:0"], "K: bounds (3.0, 0.0) are reversed or empty"),
        (
            [],
            "name the columns, with units, --columns time=COLUMN:ms u=COLUMN y=COLUMN",
        ),
    ],
)
def test_what_cannot_be_meant_is_a_sentence(capsys, own, foreign, arguments, words):
    assert words in refused(capsys, "fit", "--model", f"{own()}:Lag", "--data", foreign, *arguments)


def test_columns_go_with_data(capsys, own):
    assert "--columns goes with --model" in refused(capsys, "fit", own(OWN), "--columns", *POLAR)


def test_a_study_states_bounds_too(capsys, own, tmp_path):
    name = own()
    (tmp_path / "study.toml").write_text(
        f'[[member]]\nproblem = "{name}"\nbounds = {{K = [0, 2]}}\nstarts = 4\n'
    )
    status, out, _ = run(capsys, "batch", "study.toml", "--out", "folder", "--json")
    assert status == 0
    assert json.loads(out)["members"][0]["answer"]["at_bound"] == ["K"]
    (tmp_path / "wrong.toml").write_text(f'[[member]]\nproblem = "{name}"\nbounds = {{K = 2}}\n')
    assert "K: bounds 2 must be a pair" in refused(capsys, "batch", "wrong.toml", "--out", "other")


def test_a_study_states_starts_boxes_and_methods_as_the_options_do(own, tmp_path):
    stated = f"""[[member]]
problem = "{own()}"
start = {{K = 1.5}}
starts_box = {{K = [1, 2]}}
"""
    (tmp_path / "study.toml").write_text(stated)
    (member,) = read_study_file(tmp_path / "study.toml")
    (part,) = member.problem.parts
    assert part.parameters["K"].start == 1.5
    assert part.parameters["K"].starts == (1.0, 2.0)
    (tmp_path / "drag.toml").write_text(
        '[[member]]\nproblem = "sitl_drag"\nmethod = "single-shooting"\n'
    )
    (drag,) = read_study_file(tmp_path / "drag.toml")
    assert drag.method == gb.SingleShooting()
    (tmp_path / "bad.toml").write_text('[[member]]\nproblem = "sitl_drag"\nmethod = "single"\n')
    with pytest.raises(UsageError, match="it has multiple-shooting, single-shooting"):
        read_study_file(tmp_path / "bad.toml")
