"""Models and problems by their names, included ones and those in a user's own file."""

import pickle
import sys

import pytest

from greybox.modeling.model import Model
from greybox.modeling.model_file import module_from_file
from greybox.workflows.study.catalog import (
    find_model,
    find_problem,
    models_of,
    shipped,
    shipped_module,
)


@pytest.mark.parametrize("name", shipped("models"))
def test_every_included_model_is_found_by_its_name(name):
    for model in models_of(shipped_module("models", name)):
        found = find_model(f"{name}:{model.__name__}")
        assert type(found) is model
        assert isinstance(found, Model)


@pytest.mark.parametrize("name", shipped("problems"))
def test_every_included_problem_is_found_by_its_name(name):
    problem, settings = find_problem(name)
    assert problem.name == name
    assert set(settings) <= {"starts", "seed"}


def test_a_model_takes_arguments():
    assert find_model("polynomial:Polynomial(3, 2)").label == "Polynomial(3, 2)"
    for text in (
        "polynomial:Polynomial(n=3)",
        "polynomial:Polynomial(3, x)",
        "polynomial:Polynomial(3",
    ):
        with pytest.raises(ValueError, match=r"not understood|there is no model"):
            find_model(text)


def test_the_nearest_name_is_suggested():
    with pytest.raises(
        ValueError, match=r"no included problem 'pitch_hoover'.*did you mean 'pitch_hover'"
    ):
        find_problem("pitch_hoover")
    with pytest.raises(
        ValueError, match="there is no model 'tilt:Tilted'; tilt has Tilt, TiltRate, LinearTilt"
    ):
        find_model("tilt:Tilted")


def test_models_that_a_loop_makes_are_found(tmp_path):
    path = tmp_path / "lags_by_loop.py"
    path.write_text(
        """
import greybox as gb

for order in (1, 2):
    kind = type(
        f"Lag{order}",
        (gb.TransferFunction,),
        {
            "T": gb.Parameter(1.0, bounds=(0.1, 10)),
            "response": lambda self, s, p, order=order: 1 / (p.T * s + 1) ** order,
        },
    )
    globals()[kind.__name__] = kind
"""
    )
    model = find_model(f"{path}:Lag2")
    assert model.label == "Lag2"
    assert type(pickle.loads(pickle.dumps(model))) is type(model)  # workers get it
    sys.modules.pop("lags_by_loop")


def test_a_file_imports_its_own_neighbor_and_not_that_of_another_folder(tmp_path, monkeypatch):
    own, other = tmp_path / "own", tmp_path / "other"
    for folder in (own, other):
        folder.mkdir()
        (folder / "gain_beside.py").write_text(f"K = {folder.name!r}")
    (own / "with_neighbor.py").write_text("from gain_beside import K")
    monkeypatch.setattr(sys, "path", [str(other), *sys.path])
    assert module_from_file(own / "with_neighbor.py").K == "own"
    del sys.modules["with_neighbor"], sys.modules["gain_beside"]


def test_a_file_that_is_named_like_a_module_is_refused(tmp_path):
    path = tmp_path / "json.py"
    path.write_text("")
    with pytest.raises(
        ValueError, match=r"has the name of another Python module, 'json': rename the file"
    ):
        find_model(f"{path}:Lag")
    with pytest.raises(FileNotFoundError, match="there is no file"):
        find_problem(str(tmp_path / "none.py"))
