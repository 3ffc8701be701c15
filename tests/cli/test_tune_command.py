"""`greybox tune`: safe gains of a controller in the loop of a saved fit."""

import json
import shutil
from dataclasses import replace

import pytest
from command_line import refused, run

import greybox as gb
from greybox.problems import sitl_pitch

pytestmark = pytest.mark.usefixtures("few_draws")


def test_the_best_gains_are_written_for_the_ground_station(capsys, rate_loop, tmp_path):
    out = tmp_path / "roll.param"
    words = ("--gains", "K_P=0.01:0.5", "--names", "K_P=ATC_RAT_RLL_P", "--parameters", out)
    status, text, _ = run(capsys, "tune", *rate_loop, *words, "--json")
    assert status == 0
    answer = json.loads(text)
    best = answer["best"]["K_P"]
    assert answer["today"] == {"K_P": 0.05}
    name, value = out.read_text(encoding="utf-8").strip().split(",")
    assert (name, float(value)) == ("ATC_RAT_RLL_P", pytest.approx(best, rel=1e-6))
    assert "exists" in refused(capsys, "tune", *rate_loop, *words)


def test_gains_whose_crossover_was_not_measured_are_refused(capsys, rate_loop, tmp_path):
    out = tmp_path / "roll.param"
    words = ("--gains", "K_P=0.001:0.003", "--phase-margin", "30", "--parameters", out)
    status, text, _ = run(capsys, "tune", *rate_loop, *words)
    assert status == 1
    assert text.startswith("Refused")
    assert "fly sines or a sweep from 0.15" in text
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "give one, two or three of K_P"),
        (("--gains", "K_P=0.1"), "NAME[=LOW:HIGH]"),
        (("--gains", "K_P="), "NAME[=LOW:HIGH]"),
        (("--gains", "K_Q=0:1"), "no gain 'K_Q'"),
        (("--gains", "K_P=0:1", "--parameters", "x.csv"), ".param"),
    ],
)
def test_what_does_not_fit_is_refused(capsys, rate_loop, words, message):
    assert message in refused(capsys, "tune", *rate_loop, *words)


def test_a_gain_without_a_range_is_tried_about_its_value_of_today(capsys, rate_loop):
    _, text, _ = run(capsys, "tune", *rate_loop, "--gains", "K_P", "--json")
    tried = json.loads(text)["values"]["K_P"]
    assert (tried[0], tried[-1]) == (pytest.approx(0.05 / 4), pytest.approx(0.05 * 4))
    zero = (*rate_loop, "--set", "K_P=0", "--gains", "K_P")
    assert "K_P is 0" in refused(capsys, "tune", *zero)


def test_the_log_beside_the_fit_needs_no_option(capsys, tmp_path):
    log = {"log": sitl_pitch.LOG.name, "log sha256": gb.read(sitl_pitch.LOG).checksum}
    problem = replace(sitl_pitch.problem(), data=replace(sitl_pitch.data(), about=log))
    fit = gb.fit(problem, starts=1, profiles=False, progress=False)
    gb.save(fit, tmp_path / "pitch.h5")
    words = ("tune", tmp_path / "pitch.h5", "--phase-margin", "45", "--gain-margin", "6")
    assert "--log" in refused(capsys, *words)

    shutil.copy(sitl_pitch.LOG, tmp_path)
    status, text, _ = run(capsys, *words, "--json")
    answer = json.loads(text)
    assert status == 0
    assert set(answer["today"]) == {"ATC_RAT_PIT_P", "ATC_RAT_PIT_D"}
    status, text, _ = run(capsys, "margins", tmp_path / "pitch.h5", "--json")
    assert status == 0
    assert json.loads(text)["measured"]

    # Another log by the same name is not the one of the fit.
    (tmp_path / sitl_pitch.LOG.name).write_bytes(sitl_pitch.LOG.read_bytes()[:-100_000])
    assert "is not the log of" in refused(capsys, *words)


def test_the_controllers_of_a_log_have_the_gains_of_the_firmware(capsys, tmp_path):
    path, out = tmp_path / "pitch.h5", tmp_path / "pitch.param"
    gb.save(gb.fit(sitl_pitch.problem(), starts=1, profiles=False, progress=False), path)
    words = ("--log", sitl_pitch.LOG, "--parameters", out)
    status, text, _ = run(
        capsys,
        "tune",
        path,
        *words,
        "--gains",
        "ATC_RAT_PIT_P=0.1:0.15",
        "--level",
        "0.8",
        "--json",
    )
    assert status == 0
    answer = json.loads(text)
    assert answer["today"] == {"ATC_RAT_PIT_P": pytest.approx(0.135)}
    name, value = out.read_text(encoding="utf-8").strip().split(",")
    assert name == "ATC_RAT_PIT_P"
    assert 0.1 <= float(value) <= 0.15
    message = refused(capsys, "tune", path, *words, "--force", "--gains", "P=0.1:0.2")
    assert "ATC_ANG_PIT_P, ATC_RAT_PIT_P" in message
