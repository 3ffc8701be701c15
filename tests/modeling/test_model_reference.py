"""How a stored result names its model, and what happens when that model is gone."""

import json
import sys

import pytest
from declared_models import Integrator, LagLagDelay

import greybox as gb
from greybox.modeling.model_reference import reference, resolve, source_text
from greybox.models.polynomial import Polynomial
from greybox.models.rotor import Rotor
from greybox.models.tilt import LinearTilt, Tilt


class Outer:
    class Inner(LagLagDelay):
        """A model inside another class."""


class Configured(LagLagDelay):
    def __init__(self, thing=None):
        self.thing = thing


MODELS = [
    Tilt(),
    LinearTilt(),
    LagLagDelay(),
    Outer.Inner(),
    Polynomial(4, 1),
    Polynomial(n=3, m=0, integrator=True),
    Rotor() * Integrator(),
    Rotor() * Integrator() * Polynomial(2, 1),
    gb.feedback(Rotor(), Polynomial(2, 1), sign=1),
    gb.feedback(Rotor()),
    Rotor() * Tilt().renamed(T_rotor="T_2", T_delay="T_tilt"),
    Rotor().series(Rotor(), shared=list(Rotor().parameters)),
]


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.label)
def test_a_model_survives_json(model):
    again = resolve(
        json.loads(json.dumps(reference(model))), (LagLagDelay, Outer.Inner, Integrator)
    )
    assert type(again) is type(model)
    assert again.parameters == model.parameters
    expected, found = (
        gb.modeling.rational(m, pade=1, output=m.output_names[0]) for m in (model, again)
    )
    assert (found.numerator, found.denominator) == (expected.numerator, expected.denominator)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "gone_module_xyz:Tilt",
            "the model Tilt of the module 'gone_module_xyz' is needed and was not found",
        ),
        (
            "greybox.models.tilt:Gone",
            "the model Gone of the module 'greybox.models.tilt' is needed and was not found",
        ),
        ("greybox.models.tilt:gb", "the model gb of the module"),
        ("greybox.models.tilt:gb.TransferFunction", "the model gb.TransferFunction of the module"),
        ("math:sin", "the model sin of the module"),
        ("declared_models:LagLagDelay", "was not found"),
        ("greybox.models:tilt", "was not found"),
        ("greybox.models.tilt", "was not found"),
        ("tilt:Tilt", "was not found"),
        ("models.tilt:Tilt", "was not found"),
    ],
)
def test_a_model_that_is_gone_is_named_with_the_cure(name, words):
    with pytest.raises(LookupError, match=words) as caught:
        resolve({"class": name, "arguments": [], "keywords": {}})
    assert "gb.load(path, models=[...])" in str(caught.value)


def test_a_model_defined_inside_a_function_is_gone_later():
    class Local(LagLagDelay):
        pass

    with pytest.raises(LookupError, match="Local"):
        resolve(json.loads(json.dumps(reference(Local()))))
    assert type(resolve(reference(Local()), [Local])) is Local
    ready = Local()
    assert resolve(reference(Local()), [ready]) is ready


def test_a_class_that_was_given_wins_and_its_module_does_not_matter():
    class Tilt(LagLagDelay):
        pass

    stored = {"class": "greybox.models.tilt:Tilt", "arguments": [], "keywords": {}}
    assert type(resolve(stored)).__module__ == "greybox.models.tilt"
    Tilt.__qualname__ = "Tilt"
    assert type(resolve(stored, [Tilt])) is Tilt


@pytest.mark.parametrize(
    "name", ["this", "antigravity", "wsgiref.handlers", "greybox.cli.main", "xml.dom.minidom"]
)
def test_nothing_that_a_file_names_is_imported(name, monkeypatch):
    monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(LookupError, match="is needed and was not found"):
        resolve({"class": f"{name}:Model", "arguments": [], "keywords": {}})
    assert name not in sys.modules


def nested(depth):
    product, rotor = reference(Rotor() * Integrator()), reference(Rotor())
    stored = rotor
    for _ in range(depth):
        stored = product | {"arguments": [{"model": stored}, {"model": rotor}]}
    return stored


@pytest.mark.parametrize(
    "stored",
    [
        reference(Polynomial(4, 1)) | {"arguments": [10**6, 1]},
        reference(Polynomial(4, 1)) | {"arguments": [{"model": reference(Rotor())}, 1]},
        reference(Polynomial(4, 1)) | {"keywords": {"radius": "wide"}},
        reference(Rotor()) | {"arguments": [1]},
        reference(Rotor()) | {"parameters": 3},
        reference(Rotor()) | {"parameters": [["T_rotor"]]},
        nested(5000),
    ],
)
def test_arguments_that_no_model_has_are_a_lookup_error(stored):
    with pytest.raises(LookupError, match="is needed and was not found"):
        resolve(stored)


def test_an_argument_that_is_no_plain_value_is_stored_as_text_and_said_to_be():
    given = (Configured,)
    stored = json.loads(json.dumps(reference(Configured({"a": 1}))))
    with pytest.raises(LookupError, match=r"\{'a': 1\}, was stored as text only: give model="):
        resolve(stored, given)
    assert resolve(json.loads(json.dumps(reference(Configured([1, "b", None])))), given).thing == (
        1,
        "b",
        None,
    )


def test_a_class_that_no_longer_takes_its_arguments_is_a_lookup_error():
    stored = reference(Polynomial(4, 1)) | {"keywords": {"order": 3}}
    with pytest.raises(LookupError, match="Polynomial"):
        resolve(stored)


def test_arguments_that_a_model_does_not_take_are_refused():
    with pytest.raises(TypeError, match="Tilt"):
        Tilt(a5=0.2)
    with pytest.raises(TypeError, match="Tilt"):
        Tilt({"a5": 0.2})


def test_a_tie_is_recorded_by_its_source():
    def tie(p):
        return 2 * p.T1

    assert source_text(tie) == "def tie(p):\n        return 2 * p.T1"
    assert "eval" in source_text(eval)
