"""`greybox fit`: the answer, its JSON, its files."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
from command_line import OWN, QUICK, RECORD, refused, run
from unfolded import unfolded

import greybox as gb
from greybox.cli.fit_command import _stated_fit
from greybox.engine.solve.interruption import Interrupted
from greybox.engine.solve.lost_workers import ExecutorLostError
from greybox.problems import pitch_hover
from greybox.workflows.study.catalog import find_problem
from greybox.workflows.study.members import read_members
from greybox.workflows.study.stored_runs import StoredRuns


def test_the_main_job(capsys):
    status, out, _ = run(capsys, "fit", "pitch_hover", "--starts", "20", "--details")
    assert status == 0
    assert "0.559187" in out
    assert "angular acceleration per control" in out


def test_json_has_the_promised_keys_and_no_nan(capsys):
    status, out, _ = run(capsys, "fit", "yaw_hover", *QUICK, "--json")
    answer = json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} in JSON"))
    promised = (
        "problem criterion delay starts seed converged agreeing minima cost status estimate "
        "standard_error derived"
    )
    assert status == 0
    assert set(promised.split()) | {"warnings", "seconds", "versions"} <= set(answer)
    assert answer["problem"] == "yaw_hover"
    assert answer["starts"] == 8
    assert answer["best_effort"] is None
    assert answer["estimate"]["T_rotor"] == 0.048
    assert any("a1_tilde" in warning for warning in answer["warnings"])


def test_a_band_limits_the_responses(capsys):
    status, out, _ = run(capsys, "fit", "pitch_hover", *QUICK, "--json", "--band", 2, 8)
    narrow = pitch_hover.problem().with_(data=pitch_hover.data().between(2, 8))
    assert status == 0
    cost = gb.fit(narrow, starts=8, progress=False).cost
    assert json.loads(out)["cost"] == pytest.approx(cost, rel=1e-6)
    err = refused(capsys, "fit", "pitch_hover", "--band", 100, 200, "Hz")
    assert "the response has no point from 628.3 to 1257 rad/s" in err
    refused(capsys, "stepwise", "pitch_hover", "--band", 100, 200)


def test_the_factored_form_is_that_of_the_paper(capsys):
    """(4.32), with the rounding of its parameters."""
    status, out, _ = run(capsys, "fit", "pitch_5deg", *QUICK, "--factored", "--json")
    assert status == 0
    (line,) = json.loads(out)["factored"]
    numbers = [float(n) for n in re.findall(r"\d+\.\d+", line)]
    printed = [30.05, 0.16, 0.048, 0.124, 0.685, 3.79, 0.0042]
    assert line.startswith("pitch_5deg: ")
    assert numbers == pytest.approx(printed, rel=0.004)
    assert line in unfolded(run(capsys, "fit", "pitch_5deg", *QUICK, "--factored")[1])


def test_what_has_no_factors_is_refused_before_the_fit_or_printed_with_the_reason(capsys, own):
    assert "--factored is for frequency responses" in refused(
        capsys, "fit", "sitl_drag", "--factored"
    )

    text = OWN.replace("p.K / (p.T * s + 1)", "p.K / (p.T * gb.sqrt(s) + 1)")
    status, out, _ = run(capsys, "fit", own(text), "--factored", "--json")
    answer = json.loads(out)
    assert status == 1
    assert "K" in answer["estimate"]
    assert "rational" in answer["error"]


def test_unknown_is_null_in_json(capsys, own):
    text = OWN.replace("p.K / (p.T", "p.K / (1 + 0 * p.T) / (0.2")
    status, out, _ = run(capsys, "fit", own(text), "--json")
    answer = json.loads(out)
    assert status == 0
    assert answer["standard_error"]["T"] is None
    assert any(w.startswith("T is not determined") for w in answer["warnings"])


def test_out_and_plot_are_written_and_kept(capsys, tmp_path):

    saved, drawn = tmp_path / "pitch.h5", tmp_path / "pitch.svg"
    command = ["fit", "pitch_hover", *QUICK, "--out", saved, "--plot", drawn]
    status, out, _ = run(capsys, *command)
    assert status == 0
    assert str(saved) in out
    assert gb.load(saved).cost == pytest.approx(0.559187, rel=1e-5)
    assert "<!-- ω, rad/s -->" in drawn.read_text(encoding="utf-8")
    before = saved.read_bytes()
    assert "--force" in refused(capsys, *command)
    assert saved.read_bytes() == before
    assert run(capsys, *command[:-2], "--force")[0] == 0
    assert saved.read_bytes() != before


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


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no limit of file sizes")
def test_a_full_disk_costs_the_file_but_not_the_answer(capsys, tmp_path, monkeypatch):
    from full_disk import limited_files

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("greybox.workflows.study.stored_runs.UNWRITTEN", 0.0)
    with limited_files(4096):
        status, out, err = run(capsys, "fit", "pitch_hover", "--starts", "3", "--out", "x.h5")
    assert status == 1
    assert "a1" in out
    expected = (
        "greybox: x.h5 cannot be written (File too large): free space or choose another folder."
    )
    assert err.splitlines()[-1] == expected
    assert list(tmp_path.iterdir()) == []


def test_a_stored_result_of_a_users_model_loads_without_it(capsys, own, tmp_path):
    name = own()
    assert run(capsys, "fit", name, "--out", tmp_path / "own.h5")[0] == 0
    code = (
        "import greybox as gb, os\n"
        "def response(**options):\n"
        "    try:\n        fit = gb.load('own.h5', **options)\n        return fit.response([1.0])\n"
        "    except LookupError as error:\n        return f'MISSING {error}'\n"
        "fit = gb.load('own.h5')\n"
        "print(fit)\n"
        "print('ELSEWHERE', response())\n"
        "os.chdir('..')\n"
        "print('THERE', response())\n"
        f"print('HANDED', response(models=['{name}']))\n"
    )
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "own.h5").write_bytes((tmp_path / "own.h5").read_bytes())
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, cwd=tmp_path / "elsewhere", capture_output=True, text=True, check=True
    )
    assert "time constant" in done.stdout
    assert "ELSEWHERE MISSING the model Lag of the module" in done.stdout
    assert "THERE MISSING the model Lag of the module" in done.stdout
    assert "HANDED " in done.stdout
    assert "HANDED MISSING" not in done.stdout


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


@pytest.mark.usefixtures("unjudged")
def test_the_shipped_records(capsys):
    command = ["fit", "sitl_drag", "--starts", "1"]
    status, out, _ = run(capsys, *command)
    assert status == 0
    assert "7338 samples in 2 records" in out
    assert "v (sitl_drag_5deg): residual" in out
    answer = json.loads(run(capsys, *command, "--json")[1])
    assert answer["cost"] == pytest.approx(-17310.8607, abs=0.01)
    assert [output["part"] for output in answer["outputs"]] == ["sitl_drag_hover", "sitl_drag_5deg"]


def test_workers_give_the_same_answer(capsys):
    one, two = (
        json.loads(run(capsys, "fit", "rotors", "--starts", "20", "--workers", n, "--json")[1])
        for n in (1, 2)
    )
    assert {**one, "seconds": 0} == {**two, "seconds": 0}


def test_there_is_at_least_one_worker(capsys):
    assert "'0' is not an integer of at least 1" in refused(
        capsys, "fit", "rotors", "--workers", "0"
    )
    assert "exclude each other" in refused(
        capsys, "fit", "rotors", "--workers", "2", "--scheduler", "127.0.0.1:1"
    )


def test_dask_is_named_where_it_is_missing(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert "pip install 'greybox-id[dask]'" in refused(
        capsys, "fit", "rotors", "--scheduler", "127.0.0.1:1"
    )


def rate_response(path, **more):
    """A rate's response 90 / ((s + 0.7)(0.05 s + 1)) behind a 20 Hz filter, as a file that says its
    units."""
    omega = np.geomspace(1, 60, 15)
    s = 1j * omega
    plant = 90 / ((s + 0.7) * (0.05 * s + 1))
    corner = 2 * np.pi * 20
    filtered = plant * corner**2 / (s**2 + 2 * 0.5**0.5 * corner * s + corner**2)
    data = gb.FrequencyResponse(omega, filtered, "POut", "P", units={"P": "rad/s"}, **more)
    gb.data.write_response(data, path)


def test_a_model_of_another_quantity_is_refused_by_its_unit(capsys, tmp_path):
    rate_response(tmp_path / "rate.csv")
    status, _, err = run(
        capsys, "fit", "--model", "rate:DampedAngle", "--data", tmp_path / "rate.csv"
    )
    assert status == 2
    assert "theta is in rad/s in the response and in rad in DampedAngle" in err
    assert "take the model of the rate" in err


def test_a_filter_in_the_path_is_part_of_the_model(capsys, tmp_path):
    rate_response(tmp_path / "rate.csv")
    command = [
        "fit",
        "--model",
        "rate:DampedRotation",
        "--data",
        tmp_path / "rate.csv",
        "--starts",
        "5",
        "--json",
    ]
    answer = json.loads(run(capsys, *command, "--through", "filters:LowPass(20)")[1])
    truth = {"K_phi": 90, "a": 0.7, "T_rotor": 0.05, "T_delay": 0}
    for name, value in truth.items():
        assert answer["estimate"][name] == pytest.approx(value, rel=1e-3, abs=1e-5)
    without = json.loads(run(capsys, *command)[1])
    assert without["estimate"]["T_delay"] > 0.008


def test_a_filter_that_the_response_states_is_named(capsys, tmp_path):
    rate_response(tmp_path / "rate.csv", about={"gyro-filter": "LowPass(20.0, 0.7071067811865476)"})
    command = [
        "fit",
        "--model",
        "rate:DampedRotation",
        "--data",
        tmp_path / "rate.csv",
        "--starts",
        "3",
        "--json",
    ]
    answer = json.loads(run(capsys, *command, "--through", "gyro-filter")[1])
    assert answer["estimate"]["T_rotor"] == pytest.approx(0.05, rel=1e-3)
    status, _, err = run(capsys, *command, "--through", "gyro-notch")
    assert status == 2
    assert "has no filter 'gyro-notch'" in err


# --- fits that were ended

# Runs are on disk at once.
EAGER = (
    "import greybox.workflows.study.stored_runs\ngreybox.study.stored_runs.UNWRITTEN = 0.0\n" + OWN
)


def command(name, *words):
    return [
        sys.executable,
        "-m",
        "greybox",
        "fit",
        name,
        "--search",
        "multistart",
        "--out",
        "own.h5",
        *words,
    ]


def kept_runs():
    try:
        return sum(member.runs for member in read_members(Path("own.h5.runs")))
    except (FileNotFoundError, ValueError):  # there are no tables yet
        return 0


def test_a_fit_that_is_killed_goes_on(capsys, own, monkeypatch):
    monkeypatch.setattr(
        "greybox.workflows.study.stored_runs.UNWRITTEN", 2.0
    )  # is put back afterwards
    name = own(EAGER)
    with subprocess.Popen(command(name, "--starts", "2000")) as process:
        while kept_runs() < 8 and process.poll() is None:
            time.sleep(0.01)
        with monkeypatch.context() as hasty:
            hasty.setattr("greybox.workflows.study.study_lock.PATIENCE", 0.1)
            refusal = refused(capsys, *command(name)[3:])
        process.kill()
    assert process.returncode == -signal.SIGKILL
    assert "another process is writing to own.h5.runs" in refusal
    before = kept_runs()
    assert not Path("own.h5").exists()

    made = []
    add = StoredRuns.add
    monkeypatch.setattr(StoredRuns, "add", lambda self, *run: (made.append(run), add(self, *run)))
    count = before + 20
    assert "--force to start over" in refused(
        capsys, *command(name, "--starts", count, "--seed", "1")[3:]
    )
    assert (kept_runs(), made) == (before, [])
    assert run(capsys, *command(name, "--starts", count)[3:])[0] == 0
    assert (
        len([number for number, *_ in made if number < count]) == 20
    )  # the others sharpen the best
    assert [path.name for path in Path().glob("own.h5*")] == ["own.h5"]
    fit, whole = (
        gb.load("own.h5"),
        gb.fit(find_problem(name)[0], count, 3, search="multistart", progress=False),
    )
    assert [r.cost for r in fit.runs] == [r.cost for r in whole.runs]
    assert (fit.estimate, fit.standard_error) == (whole.estimate, whole.standard_error)
    assert "own.h5 exists: give another name, or --force" in refused(capsys, *command(name)[3:])


def test_a_fit_that_ends_early_goes_on(capsys, own, monkeypatch, press_ctrl_c):
    monkeypatch.setattr("greybox.workflows.study.stored_runs.UNWRITTEN", 2.0)
    name = own()
    add = StoredRuns.add
    monkeypatch.setattr(
        StoredRuns, "add", lambda self, *run: (run[0] == 7 and press_ctrl_c(), add(self, *run))
    )
    status, out, err = run(capsys, *command(name, "--starts", 30)[3:])
    assert (status, err) == (130, "greybox: interrupted.\n")
    assert "the same command continues with 8 runs" in out
    assert len(gb.load("own.h5").runs) == kept_runs() == 8
    monkeypatch.setattr(StoredRuns, "add", add)

    # Of another problem only with --force, which then begins anew.
    other = command(f"{name}:other", "--starts", 4)[3:]
    assert "--force to start over" in refused(capsys, *other)
    assert len(gb.load("own.h5").runs) == kept_runs() == 8
    assert run(capsys, *other, "--force")[0] == 0
    assert len(gb.load("own.h5").runs) == 4
    assert kept_runs() == 0


def test_a_fit_that_its_time_limit_ends_goes_on(capsys, own, clock):
    name = own()
    status, out, _ = run(capsys, *command(name, "--starts", 30, "--seconds", 200)[3:])
    done = len(gb.load("own.h5").runs)
    assert status == 0
    assert 1 <= done < 30
    assert f"the time limit ended the search after {done} of 30 starts" in out
    kept = kept_runs()
    assert done - 1 <= kept <= done  # the limit may have cut the last run
    assert f"the same command continues with {kept} runs" in out
    status, out, _ = run(capsys, *command(name, "--starts", 30, "--seconds", 10_000)[3:])
    assert status == 0
    assert len(gb.load("own.h5").runs) == 30
    assert "time limit" not in out
    assert kept_runs() == 0


@pytest.mark.parametrize("text", ["0", "-1", "soon", "nan", "inf"])
def test_what_is_no_time_is_refused(capsys, text):
    message = refused(capsys, "fit", "pitch_hover", f"--seconds={text}")
    assert f"argument --seconds: '{text}' is not a number above 0" in message


def fit_options(**stated):
    known = {
        "starts": None,
        "seed": None,
        "search": "batched",
        "no_profiles": False,
        "factored": False,
        "band": [],
    }
    return Namespace(**known | stated)


def test_starts_and_seed_of_the_command_come_before_those_of_the_problem(monkeypatch):
    def stated(**options):
        settings = {"starts": 5, "seed": 3, "method": gb.SingleShooting()}
        monkeypatch.setattr(
            "greybox.cli.problem_options.stated_problem",
            lambda options: (pitch_hover.problem(), settings),
        )
        return _stated_fit(fit_options(**options))

    made = stated()
    assert (made["starts"], made["seed"], made["profiles"]) == (5, 3, True)
    assert (type(made["by"].method), made["by"].search) == (gb.SingleShooting, "batched")
    made = stated(starts=9, seed=0, no_profiles=True, search="multistart")
    assert (made["starts"], made["seed"], made["profiles"], made["by"].search) == (
        9,
        0,
        False,
        "multistart",
    )


@pytest.mark.parametrize(
    ("out", "more"),
    [("own.h5", "; the same command continues with the stored runs"), (None, "")],
)
def test_workers_that_are_lost_are_told(capsys, own, monkeypatch, out, more):
    def lost(*arguments, **options):
        raise ExecutorLostError("the workers are gone.")

    monkeypatch.setattr("greybox.cli.fit_command.fit_with_storage", lost)
    words = [] if out is None else ["--out", out]
    assert run(capsys, "fit", own(), *words) == (1, "", f"greybox: the workers are gone{more}.\n")


def test_ctrl_c_before_any_run_has_no_answer_and_while_drawing_no_figure(
    capsys, own, monkeypatch, tmp_path
):
    name = own()

    def stopped(*arguments, **options):
        raise Interrupted("interrupted before the first start")

    with monkeypatch.context() as before:
        before.setattr("greybox.cli.fit_command.fit_with_storage", stopped)
        assert run(capsys, "fit", name) == (130, "", "greybox: interrupted.\n")

    def drawing(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("greybox.cli.fit_command.save_figure", drawing)
    status, out, err = run(capsys, "fit", name, "--starts", "1", "--plot", tmp_path / "own.png")
    assert (status, err) == (130, "greybox: interrupted.\n")
    assert out.splitlines()[-1] == f"{tmp_path / 'own.png'} is not drawn"


def test_a_figure_in_hertz(capsys, tmp_path):
    path = tmp_path / "fit.svg"
    run(capsys, "fit", "pitch_hover", "--starts", "2", "--plot", path, "--hz")
    assert "<!-- Frequency, Hz -->" in path.read_text(encoding="utf-8")
    assert "rad/s -->" not in path.read_text(encoding="utf-8")
