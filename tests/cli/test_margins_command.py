"""`greybox margins`: the loop of a saved fit and a controller."""

import json

import numpy as np
import pytest
from command_line import refused, run

import greybox as gb
from greybox.models.controller import AttitudeController
from greybox.problems import pitch_hover, sitl_pitch

pytestmark = pytest.mark.usefixtures("few_draws")

LOOP = ("--controller", "controller:AttitudeController", "--signals", "q=theta_dot")


@pytest.fixture(scope="module")
def pitch(tmp_path_factory):
    path = tmp_path_factory.mktemp("fits") / "pitch.h5"
    gb.save(gb.fit(pitch_hover.problem(), starts=2, profiles=False, progress=False), path)
    return path


def test_the_command_answers_as_the_function_does(capsys, pitch):
    settings = ("--set", "K_P=0.1", "--rate", "200", "--broken-at", "u", "theta")
    settings += ("--boundary", "0:2", "0.3:5")
    status, out, _ = run(capsys, "margins", pitch, *LOOP, *settings, "--json")
    assert status == 0
    controller = AttitudeController({"K_P": 0.1}, rate=200, signals={"q": "theta_dot"})
    curve = [(0.0, 2.0), (0.3, 5.0)]
    expected = gb.margins(gb.load(pitch), controller, broken_at="theta", boundary=curve).to_dict()
    loops = json.loads(out)["loops"]
    assert loops[1] == expected != loops[0]
    assert loops[1]["margins"]["bandwidth above the boundary"]["value"] is not None
    assert "0=2" in refused(capsys, "margins", pitch, *LOOP, "--boundary", "0=2")


def test_the_controller_comes_from_a_log(capsys, pitch):
    words = ("--log", sitl_pitch.LOG, "--broken-at", "theta", "--json")
    status, out, _ = run(capsys, "margins", pitch, *words)
    assert status == 0
    answer = json.loads(out)
    assert 0.05 < answer["control_residual"] < 0.1  # every seventh pass was logged
    low_pass, angle, rate = answer["controllers"]
    assert low_pass["values"] == {"cutoff": 20.0, "gyro_rate": 1000.0}
    assert low_pass["signals"]["raw"] == "theta_dot"
    assert angle["values"]["delay"] == answer["samples_late"]["q_reference"] == 2
    assert rate["values"]["P"] == pytest.approx(0.135)
    assert answer["loops"][0]["margins"]["phase margin"]["value"] > 30
    assert [loop["broken_at"] for loop in answer["loops"]] == ["u", "theta"]
    assert answer["measured"] == []  # the response of the paper has no variance


def test_measured_points_are_on_the_page(capsys, tmp_path):
    fit = gb.fit(sitl_pitch.problem(), starts=1, profiles=False, progress=False)
    saved, page = tmp_path / "sitl.h5", tmp_path / "page.html"
    gb.save(fit, saved)
    run(capsys, "margins", saved, "--log", sitl_pitch.LOG, "--broken-at", "theta", "--report", page)
    _, at_control, at_attitude = page.read_text(encoding="utf-8").split("<strong>Nichols diagram")
    name = "the measured response and the controller"
    assert name in at_control
    # The table of the measured margins names it again; the figures of the other loop do not.
    assert name not in at_attitude.split("<pre>")[0]


def test_the_loop_is_drawn(capsys, rate_loop, tmp_path):
    drawn = tmp_path / "loop.png"
    _, out, _ = run(capsys, "margins", *rate_loop, "--plot", drawn)
    assert drawn.stat().st_size > 10_000
    assert "loop.png" in out


def test_several_fits_are_shown_in_a_table_and_on_a_page(capsys, rate_loop, tmp_path):
    page = tmp_path / "page.html"
    other = tmp_path / "forward.h5"
    fit, *loop = rate_loop
    other.write_bytes(fit.read_bytes())
    _, out, _ = run(capsys, "margins", fit, other, *loop, "--report", page)
    header, _, *rows = out.splitlines()[:4]
    assert "phase margin, deg" in header
    for row, file in zip(rows, (fit, other), strict=True):
        assert row.startswith(f"{file} ")
    text = page.read_text(encoding="utf-8")
    assert "Stability margins" in text
    assert text.count("<strong>Nichols diagram") == 2
    assert "a single RESULT" in refused(capsys, "margins", fit, other, "--log", sitl_pitch.LOG)
    # Nothing is said of a log that nobody stated.
    assert "no controller" in refused(capsys, "margins", fit, other)


def test_a_study_without_a_finished_member_has_no_margins(capsys, tmp_path):
    member = gb.study.Member(sitl_pitch.problem(), name="slow", starts=400)
    gb.batch([member], tmp_path / "study", seconds=0.001)
    words = ("--controller", "controller:AttitudeController")
    assert "no finished member" in refused(capsys, "margins", tmp_path / "study", *words)


def test_a_table_is_a_measured_loop(capsys, pitch, tmp_path):
    omega = np.geomspace(0.3, 30, 40)
    bode = tmp_path / "loop.csv"
    loop = 2 / (1j * omega) * np.exp(-0.2j * omega)
    phase = np.degrees(np.unwrap(np.angle(loop)))
    rows = zip(omega, 20 * np.log10(abs(loop)), phase, strict=True)
    lines = ["w [rad/s],L [dB],phi [deg]", *(",".join(map(str, row)) for row in rows)]
    bode.write_text("\n".join(lines))
    status, out, _ = run(capsys, "margins", bode, "--json")
    assert status == 0
    (answer,) = json.loads(out)["loops"]
    expected = gb.margins(gb.read_response(bode))
    assert answer["margins"]["phase margin"]["value"] == expected["phase margin"].value
    assert expected["phase margin"].value == pytest.approx(90 - np.degrees(0.4), abs=0.1)
    assert "broken loop itself" in refused(capsys, "margins", bode, *LOOP)
    for both in ((bode, pitch), (pitch, bode)):
        assert f"{bode} is a measured loop: fits" in refused(capsys, "margins", *both)
    assert run(capsys, "margins", bode, "--plot", tmp_path / "loop.png")[0] == 0
    assert (tmp_path / "loop.png").stat().st_size > 10_000
    assert run(capsys, "margins", bode, "--report", tmp_path / "loop.html")[0] == 0
    page = (tmp_path / "loop.html").read_text()
    assert all(title in page for title in ("Broken loop", "Nichols diagram", "Nyquist diagram"))


def test_a_loop_that_is_not_stable_fails(capsys, rate_loop):
    status, out, _ = run(capsys, "margins", *rate_loop, "--set", "K_P=9")
    assert status == 1
    assert "unstable" in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "give --log with the flight, or --controller"),
        (("--log", sitl_pitch.LOG.with_name("table_4_3.csv")), "no parameters"),
        (("--log", sitl_pitch.LOG, "--axis", "heave"), "'heave' is not one of"),
        (("--log", sitl_pitch.LOG, "--set", "P=0.2"), "--set states a controller"),
        (("--log", sitl_pitch.LOG, *LOOP), "leave out one of them"),
        (("--log", sitl_pitch.LOG, "--at", "w=1"), "no operating point"),
        (("--controller", "controller:Attitude"), "did you mean 'AttitudeController'"),
        ((*LOOP, "--set", "K_Q=1"), "has no gain 'K_Q'"),
        ((*LOOP[:2], "--signals", "q"), "OWN=PLANT"),
        (LOOP[:2], "no 'q' to measure"),
        ((*LOOP, "--broken-at", "w"), "the loop has no signal 'w'"),
        ((*LOOP, "--level", "95"), "between 0 and 1"),
    ],
)
def test_what_does_not_fit_is_refused(capsys, pitch, words, message):
    assert message in refused(capsys, "margins", pitch, *words)
