"""`greybox tune`: safe gains of a controller in the loop of a saved fit."""

import json
import shutil
from dataclasses import replace

import pytest
from command_line import refused, run
from unfolded import unfolded

import greybox as gb
from greybox.problems import sitl_pitch

pytestmark = pytest.mark.usefixtures("few_draws")


WITH_D = """
import greybox as gb

class RateLoopWithD(gb.Controller):
    # With small gains, and a filtered derivative.
    states, inputs, outputs, rate = ("error", "derivative"), ("p",), ("u",), 400
    K_P = gb.Parameter(0.05, bounds=(0, 10))
    K_D = gb.Parameter(0.002, bounds=(0, 10))

    def update(self, x, u, p):
        error = u.reference - u.p
        derivative = x.derivative + ((error - x.error) * self.rate - x.derivative) / 4
        return (error, derivative), (p.K_P * error + p.K_D * derivative,)
"""


def test_proposed_gains_are_written_for_the_ground_station(capsys, rate_loop, tmp_path):
    out, controller = tmp_path / "roll.param", tmp_path / "with_d.py"
    controller.write_text(WITH_D, encoding="utf-8")
    loop = (rate_loop[0], "--controller", f"{controller}:RateLoopWithD")
    gains = ("--gains", "K_P", "K_D", "--noise-factor", "3")
    names = ("--names", "K_P=ATC_RAT_RLL_P", "K_D=ATC_RAT_RLL_D")
    words = (*gains, *names, "--parameters", out)
    status, text, _ = run(capsys, "tune", *loop, *words, "--json")
    assert status == 0
    answer = json.loads(text)
    assert answer["today"] == {"K_P": 0.05, "K_D": 0.002}
    assert answer["reason"] is None
    assert answer["comparison"]["objective"]["high"] <= 0.75
    steps = [tmp_path / f"roll{end}.param" for end in ("_step1", "_step2", "")]
    for path, step in zip(steps, answer["steps"], strict=True):
        lines = path.read_text(encoding="utf-8").splitlines()
        reasons = [line for line in lines if line.startswith("# ")]
        written = dict(line.split(",") for line in lines[len(reasons) :])
        assert {name: float(value) for name, value in written.items()} == pytest.approx(
            {"ATC_RAT_RLL_P": step["K_P"], "ATC_RAT_RLL_D": step["K_D"]}, rel=1e-6
        )
        text = "\n".join(reasons)
        assert "Proposed: K_P = " in text
        assert "Today's gains: K_P 0.05, K_D 0.002" in text
        assert "noise from p to u" in text
    assert answer["steps"][-1] == answer["best"]
    assert "exists" in refused(capsys, "tune", *loop, *words)


def test_nothing_is_written_where_todays_gains_are_to_be_kept(capsys, rate_loop, tmp_path):
    """A larger gain amplifies noise, and a smaller one rejects less: an answer, but no file."""
    out = tmp_path / "roll.param"
    words = ("--gains", "K_P=0.01:0.5", "--parameters", out)
    status, text, _ = run(capsys, "tune", *rate_loop, *words)
    assert status == 0
    assert text.startswith("Keep today's gains: ")
    assert "noise from p to u" in text
    assert f"{out} was not written." in text
    assert not out.exists()
    status, text, _ = run(capsys, "tune", *rate_loop, *words, "--json")
    assert status == 0
    answer = json.loads(text)
    assert "error" not in answer
    assert answer["best"] is None
    assert answer["reason"].startswith("keep today's gains")
    assert not out.exists()


def test_gains_that_are_unstable_today_are_refused(capsys, rate_loop, tmp_path):
    out = tmp_path / "roll.param"
    words = ("--set", "K_P=5", "--gains", "K_P=0.01:0.5", "--parameters", out)
    status, _, errors = run(capsys, "tune", *rate_loop, *words)
    assert status == 1
    assert "the loop of today's gains is unstable with the fitted plant" in errors
    assert not out.exists()


def test_gains_whose_crossover_was_not_measured_are_refused(capsys, rate_loop, tmp_path):
    out = tmp_path / "roll.param"
    words = ("--gains", "K_P=0.001:0.003", "--phase-margin", "30", "--parameters", out)
    status, text, _ = run(capsys, "tune", *rate_loop, *words)
    assert status == 1
    assert text.startswith("Refused")
    assert "fly sines or a sweep from 0.15" in unfolded(text)
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
    assert (tried[0], tried[-1]) == (pytest.approx(0.05 / 2), pytest.approx(0.05 * 2))
    _, text, _ = run(capsys, "tune", *rate_loop, "--gains", "K_P", "--range", "4", "--json")
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
    assert answer["best"] is None
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
    # More P amplifies the noise of the gyro, and less of it lets a moment move the vehicle farther.
    assert answer["best"] is None
    assert not out.exists()
    message = refused(capsys, "tune", path, *words, "--force", "--gains", "P=0.1:0.2")
    assert "ATC_ANG_PIT_P, ATC_RAT_PIT_P" in message
