"""`greybox list` shows what is included."""

import json

import pytest
from command_line import refused, run

from greybox.data.files.numbers_in_text import number
from greybox.models.tilt import Tilt


def test_list_names_every_shipped_problem_and_model(capsys):
    status, out, _ = run(capsys, "list")
    assert status == 0
    for name in ("pitch_hover", "rotors", "tilt:Tilt", "yaw:YawStates", "multirotor:RigidBody"):
        assert name in out
    answer = json.loads(run(capsys, "list", "--json")[1])
    assert all("$$" in model["about"] for model in answer["models"])
    assert all("Source:" in item["about"] for item in answer["models"] + answer["problems"])


@pytest.mark.parametrize("name", ["tilt:Tilt", "pitch_hover", "polynomial:Polynomial(3, 1)"])
def test_list_shows_one_whole(capsys, name):
    status, out, _ = run(capsys, "list", name)
    assert status == 0
    assert "$$" in out
    assert "meaning" in out


def test_a_file_of_several_models_names_them(capsys):
    assert "tilt has Tilt, TiltRate" in refused(capsys, "list", "tilt")


def test_a_model_is_shown_with_all_that_it_declares(capsys):
    model = Tilt()
    rows = [
        {"name": name, "start": p.start, "bounds": list(p.bounds), "unit": p.unit, "about": p.about}
        | {"fixed": p.fixed, "scale": p.scale}
        for name, p in model.parameters.items()
    ]
    answer = json.loads(run(capsys, "list", "tilt:Tilt", "--json")[1])
    assert answer["parameters"] == rows
    assert (answer["inputs"], answer["outputs"]) == (
        list(model.input_names),
        list(model.output_names),
    )
    assert answer["name"] == "tilt:Tilt"
    lines = run(capsys, "list", "tilt:Tilt")[1].splitlines()
    assert lines[0] == "Tilt: u -> theta"
    begins = next(
        k
        for k, line in enumerate(lines)
        if line.split() == ["parameter", "start", "bounds", "unit", "meaning"]
    )
    for line, (name, p) in zip(lines[begins + 2 :], model.parameters.items(), strict=True):
        bounds = f"[{p.bounds[0]:g}, {p.bounds[1]:g}]"
        words = [
            name,
            number(p.start),
            *bounds.split(),
            p.unit,
            *(["fixed"] if p.fixed else []),
            *p.about.split(),
        ]
        assert line.split() == words
        # Texts begin below their headings.
        for heading, text in (("parameter", name), ("unit", p.unit), ("meaning", p.about)):
            assert line[lines[begins].index(heading) :].startswith(text)
