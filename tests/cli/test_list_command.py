"""`greybox list` shows what is included."""

import json

import pytest
from command_line import run


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
