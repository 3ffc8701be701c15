"""`greybox response`: from a log to a measured response."""

import json
import math
import shlex
from argparse import Namespace
from importlib.resources import files

import numpy as np
import pytest
from command_line import refused, run

import greybox as gb
from greybox.cli.options import UsageError
from greybox.cli.response_command import stated_choices

LOG = str(files("greybox.problems") / "data" / "sitl_pitch.BIN")
PITCH = ["--announced", "SINE", "--input", "u=RATE.POut", "--output", "theta=ATT.Pitch"]


def test_log_to_response_to_fit(capsys, tmp_path):
    out = tmp_path / "pitch.csv"
    status, text, _ = run(
        capsys, "response", LOG, *PITCH, "--out", out, "--plot", tmp_path / "bode.png"
    )
    assert status == 0
    assert "no problems found" in text
    measured = gb.read_response(out, input="u", output="theta")
    assert len(measured) == 10
    assert measured.variance is not None
    status, text, _ = run(
        capsys, "fit", "--model", "rate:DampedAngle", "--data", out, "--starts", "10", "--json"
    )
    assert status == 0
    assert json.loads(text)["estimate"]["K_phi"] == pytest.approx(91.0, rel=0.01)


def test_single_tests_can_be_chosen(capsys):
    answer = json.loads(run(capsys, "response", LOG, *PITCH, "--tests", "1,4-6", "--json")[1])
    assert sorted(answer["omega"]) == pytest.approx([4.0, 5.34, 8.0, 20.11], rel=1e-3)


def test_one_frequency_alone_is_refused_with_the_reason(capsys, tmp_path):
    status, out, err = run(
        capsys, "response", LOG, *PITCH, "--tests", "2", "--json", "--out", tmp_path / "x.csv"
    )
    assert status == 1
    assert "one frequency gives two numbers" in json.loads(out)["error"]
    assert "one frequency gives two numbers" in err
    assert not (tmp_path / "x.csv").exists()


def sweep_table(path, noise=0.0):
    """A sweep through 5 / (0.2 s + 1), as a table."""
    from scipy.signal import chirp, lsim

    time = np.arange(0, 60, 0.01)
    u = chirp(time, 0.1, 60, 5, method="logarithmic") * np.minimum(
        1, np.minimum(time, 60 - time) / 3
    )
    y = lsim(([5], [0.2, 1]), u, time)[1] + noise * np.random.default_rng(0).normal(size=time.size)
    np.savetxt(path, np.c_[time, u, y], delimiter=",", header="time,u,y", comments="")


def closed_loop_table(path, setpoint):
    """A lag in a feedback loop that follows `setpoint(t)`, with sensor noise, as a table time, r,
    u, y."""
    step, y, x = 0.01, 0.0, 0.0
    rows = []
    for t, noise in zip(
        np.arange(0, 80, step), np.random.default_rng(1).normal(0, 1e-3, 8000), strict=True
    ):
        r, y = setpoint(t), x + noise
        u = 4 * (r - y)
        rows.append((t, r, u, y))
        x += step * (u - x) / 0.5
    np.savetxt(path, rows, delimiter=",", header="time,r,u,y", comments="")


@pytest.mark.parametrize(
    "setpoint", [lambda t: 0.1 * np.sin(0.05 * t), lambda t: 1e-5 * np.sin(3 * t)]
)
def test_what_cannot_identify_anything_is_refused(capsys, tmp_path, setpoint):
    """Excited at 0.05 rad/s only, or with the amplitude of the sensor's noise."""
    closed_loop_table(tmp_path / "flight.csv", setpoint)
    status, out, _ = run(
        capsys, "response", tmp_path / "flight.csv", "--input", "u", "--output", "y", "--json"
    )
    assert status in (1, 2)
    assert json.loads(out)["error"]


def test_a_table_of_a_sweep_gives_its_response(capsys, tmp_path):
    sweep_table(tmp_path / "sweep.csv")
    command = ["response", tmp_path / "sweep.csv", "--input", "u", "--output", "y", "--json"]
    status, out, _ = run(capsys, *command)
    assert status == 2
    assert "--whole for the whole log" in json.loads(out)["error"]
    status, out, _ = run(capsys, *command, "--whole")
    answer = json.loads(out)
    omega = np.array(answer["omega"])
    inner = (omega > 1.5) & (omega < 20)
    found = (np.array(answer["alpha"]) + 1j * np.array(answer["beta"]))[inner]
    assert status == 0
    assert inner.sum() > 5
    assert np.max(np.abs(found / (5 / (0.2j * omega[inner] + 1)) - 1)) < 0.03


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["inspect", "none.BIN"], "there is no file none.BIN"),
        (["inspect", LOG, "--announced", "SINUS"], "no message 'SINUS'"),
        (["inspect", LOG, "--plot", "x.xyz"], "not a known kind of figure"),
        (["response", LOG], "--input"),
        (["response", LOG, "--input", "RATE.POot", "--output", "ATT.Pitch"], "no signal 'POot'"),
        (["response", LOG, *PITCH, "--tests", "11"], "--tests '11' must lie between 1 and 10"),
        (["response", LOG, *PITCH, "--tests", "a"], "write numbers and ranges"),
        (["response", LOG, *PITCH, "--tests", "5-3"], "must not run backwards"),
        (
            ["response", LOG, *PITCH, "--tests", "1-99999999999"],
            "--tests '1-99999999999' must lie between 1 and 10",
        ),
        (["response", LOG, *PITCH, "--points", "1"], "--points 1"),
        (["response", LOG, *PITCH, "--settle", "nan"], "--settle nan"),
        (["response", LOG, *PITCH, "--rate", "1e9"], "more than ten times"),
        (
            ["response", LOG, "--input", "x=RATE.POut", "--output", "x=ATT.Pitch"],
            "have the same name",
        ),
        (
            ["response", LOG, "--input", "RATE.POut", "--output", "y=RATE.POut"],
            "are the same signal",
        ),
        (["response", LOG, *PITCH, "--axis", "roll"], "no test has the axis 'roll'"),
        (["response", LOG, *PITCH, "--rate", "0"], "--rate: '0' is not a number above 0"),
        (["response", LOG, *PITCH, "--out", "x.txt"], "end it in .csv"),
        (["response", LOG, *PITCH, "--fields", "omega"], "write WHAT=FIELD"),
    ],
)
def test_bad_input_is_one_sentence(capsys, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *arguments)
    assert status == 2
    assert out == ""
    assert words in err
    assert len(err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def two_sided_loop(path, noise):
    """A lag 1 / (0.5 s + 1) under u = 4 (r - y).

    A sweep of r, and noise in y that is as strong above its band.
    """
    from scipy.signal import chirp

    step, y, x = 0.01, 0.0, 0.0
    rows = []
    time = np.arange(0, 120, step)
    setpoint = chirp(time, 0.1, 120, 5, method="logarithmic")
    disturbance = np.random.default_rng(1).normal(0, noise, time.size)
    for t, r, v in zip(time, setpoint, disturbance, strict=True):
        y = x + v
        u = 4 * (r - y)
        rows.append((t, r, u, y))
        x = math.exp(-step / 0.5) * x + (1 - math.exp(-step / 0.5)) * u
    np.savetxt(path, rows, delimiter=",", header="time,r,u,y", comments="")


def lag(omega):
    held = np.exp(-0.01 / 0.5)
    z = np.exp(0.01j * omega)
    return (1 - held) / (z - held)


def test_in_closed_loop_the_excitation_is_the_instrument(capsys, tmp_path):
    """The direct estimate of the same record is drawn toward -1/4 by its noise, the joint one is
    not."""
    two_sided_loop(tmp_path / "flight.csv", 0.2)
    command = ["response", tmp_path / "flight.csv", "--input", "u", "--output", "y", "--json"]
    answer = json.loads(run(capsys, *command)[1])
    omega = np.array(answer["omega"])
    truth = lag(omega)
    joint = np.array(answer["alpha"]) + 1j * np.array(answer["beta"])
    assert answer["closed_loop"] is True
    assert answer["instrument"] == "r"
    standardized = np.abs(joint - truth) / np.sqrt(answer["variance"])
    assert 0.5 < np.sqrt(np.mean(standardized**2)) < 1.5
    direct = json.loads(run(capsys, *command, "--open-loop")[1])
    biased = np.array(direct["alpha"]) + 1j * np.array(direct["beta"])
    error = np.abs(biased - lag(np.array(direct["omega"]))) / np.sqrt(direct["variance"])
    assert np.sqrt(np.mean(error**2)) > 2
    at = np.array(direct["omega"]) > 10
    assert (
        np.abs(biased[at] + 0.25).mean() < np.abs(lag(np.array(direct["omega"])[at]) + 0.25).mean()
    )


def test_a_closed_loop_without_an_excitation_is_refused(capsys, tmp_path):
    closed_loop_table(tmp_path / "flight.csv", lambda t: 0.0)
    command = [
        "response",
        tmp_path / "flight.csv",
        "--input",
        "u",
        "--output",
        "y",
        "--whole",
        "--json",
    ]
    status, out, _ = run(capsys, *command)
    assert status == 2
    assert "closed loop (r is in it)" in json.loads(out)["error"]
    assert "--open-loop if you know" in json.loads(out)["error"]
    assert "closed loop" not in json.loads(run(capsys, *command, "--open-loop")[1]).get("error", "")


def test_a_band_is_cut(capsys, tmp_path):
    sweep_table(tmp_path / "sweep.csv")
    command = [
        "response",
        tmp_path / "sweep.csv",
        "--input",
        "u",
        "--output",
        "y",
        "--whole",
        "--json",
        "--band",
    ]
    answer = json.loads(run(capsys, *command, "0.5", "2", "Hz")[1])
    assert min(answer["omega"]) >= np.pi
    assert max(answer["omega"]) <= 4 * np.pi
    answer = json.loads(run(capsys, "response", LOG, *PITCH, "--band", "3", "9", "--json")[1])
    assert sorted(answer["omega"]) == pytest.approx([3, 3.5, 4, 5.34, 8], rel=1e-3)
    for words, reason in (
        (["2"], "not understood"),
        (["5", "2"], "the lower one first"),
        (["30", "40"], "no sine lies in"),
    ):
        assert reason in run(capsys, "response", LOG, *PITCH, "--band", *words)[2]


def test_what_was_chosen_and_dropped_is_said(capsys, tmp_path):
    out = tmp_path / "pitch.csv"
    text = run(capsys, "response", LOG, "--setpoint", "ATT.DesPitch", *PITCH[2:], "--out", out)[1]
    assert (
        "closed loop (ATT.DesPitch is in the log): amplitudes at the frequency of the excitation"
        in text
    )
    assert (
        "converted: theta from deg to rad with half a step of 0.01 deg, which the log truncates"
        in text
    )
    about = gb.read_response(out).about
    assert about["log"] == "sitl_pitch.BIN"
    assert about["signals"].startswith("u = RATE.POut, theta = ATT.Pitch")
    assert about["excitation"].startswith("10 sines of ATT.DesPitch, amplitude 2.9")
    assert gb.read_response(out).units["theta"] == "rad"


def test_a_matrix_of_responses_from_the_log_to_a_model(capsys, tmp_path):
    """Two multisines at once, each of which moves both inputs.

    P = 4/(s + 2) da + 1.5/(s + 1) dr by simulation.
    """
    test = gb.experiment.multisine(1.0, 15.0, 20.0, 25.0, signals=("da", "dr"), periods=1)
    pure = np.tile([test["da"][:500], test["dr"][:500]], 5)
    moved = np.array([[1, 0.4], [-0.4, 1]]) @ pure
    omega = 2 * np.pi / 20 * np.arange(251)
    plant = np.array([4 / (1j * omega + 2), 1.5 / (1j * omega + 1)])
    p = np.tile(np.fft.irfft((plant * np.fft.rfft(moved[:, :500])).sum(axis=0)), 5)
    rest = np.zeros((5, 250))
    flown = np.hstack([rest, [*moved, *pure, p], rest])
    flown[4] += 0.02 * np.random.default_rng(1).standard_normal(3000)
    log, out = tmp_path / "flight.csv", tmp_path / "matrix.csv"
    rows = np.column_stack([0.04 * np.arange(3000), flown.T])
    np.savetxt(log, rows, delimiter=",", header="time (s),da,dr,e_a,e_r,p", comments="")
    command = [
        "response",
        log,
        "--input",
        "da",
        "dr",
        "--output",
        "p",
        "--period",
        "20",
        "--instrument",
        "e_a",
        "e_r",
    ]
    status, text, _ = run(
        capsys, *command, "--out", out, "--plot", tmp_path / "matrix.png", "--json"
    )
    answer = json.loads(text)
    assert status == 0
    assert [(one["output"], one["input"]) for one in answer["responses"]] == [
        ("p", "da"),
        ("p", "dr"),
    ]
    assert (
        "from 12.00 to 110.00 s at 25 Hz: 4 periods of 20 s, after 2 s of settling."
        in answer["choices"]
    )
    assert (tmp_path / "matrix.png").read_bytes().startswith(b"\x89PNG")
    for one, truth in zip(answer["responses"], [(4.0, 2.0), (1.5, 1.0)], strict=True):
        s = 1j * np.array(one["omega"])
        errors = np.array(one["alpha"]) + 1j * np.array(one["beta"]) - truth[0] / (s + truth[1])
        assert 0.6 < np.sqrt(np.mean((np.abs(errors) ** 2 / one["variance"])[2:-2])) < 1.6

    read = gb.read_response(out, input="dr", output="p")
    assert read.alpha.tolist() == answer["responses"][1]["alpha"]
    fit = ["fit", "--model", "rotor:Rotor", "--data", out]
    assert "has several responses, p_da, p_dr: choose one" in refused(capsys, *fit)
    fitted = run(capsys, *fit, "--input", "da", "--output", "p", "--starts", "4", "--json")
    assert json.loads(fitted[1])["estimate"]["T_rotor"] == pytest.approx(0.5, rel=0.02)
    assert "--period of the multisines" in refused(capsys, *command[:7])
    out = tmp_path / "zweite Größe.csv"
    saved, following = run(capsys, *command, "--out", out)[1].splitlines()[-2:]
    assert saved == f"saved {out}"
    words = shlex.split(following.removeprefix("  fit one: greybox "))
    assert words == [*fit[:2], "MODEL", "--data", str(out), "--input", "da", "--output", "p"]
    assert "end it in .csv" in refused(capsys, *command, "--out", tmp_path / "matrix.h5")
    assert "there are 1 excitations for 2 inputs" in refused(capsys, *command[:-1])


def test_several_signals_need_a_period_and_are_named(capsys):
    several = ("response", LOG, "--input", "u=RATE.POut", "r=RATE.ROut", "--output", "q=RATE.P")
    assert "several signals: give one of each, or the --period" in refused(capsys, *several)


def test_one_input_has_one_instrument():
    with pytest.raises(
        UsageError,
        match=r"--instrument SIDD\.Targ X\.y has more signals than there are inputs",
    ):
        stated_choices(Namespace(instrument=["SIDD.Targ", "X.y"]))


def test_a_refused_multisine_names_the_option_that_states_its_period(capsys, tmp_path):
    time = np.arange(2000) / 100
    phases = np.pi * time[:, None] * np.array([1, 2, 3, 5])
    path = tmp_path / "multisine.csv"
    columns = np.c_[time, np.sin(phases).sum(axis=1), np.sin(phases - 0.3).sum(axis=1)]
    np.savetxt(path, columns, delimiter=",", header="time [s],u,y", comments="")
    _, out, err = run(capsys, "response", path, "--input", "u", "--output", "y", "--whole")
    assert "state it, --period 2." in err
    assert "--period 2." in out
