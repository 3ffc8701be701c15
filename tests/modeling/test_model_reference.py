"""How a stored result names its model, and what happens when that model is gone."""

import json

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
]


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.label)
def test_a_model_survives_json(model):
    again = resolve(json.loads(json.dumps(reference(model))))
    assert type(again) is type(model)
    assert again.parameters == model.parameters
    expected, found = (gb.modeling.rational(m, pade=1, output=m.output_names[0]) for m in (model, again))
    assert (found.numerator, found.denominator) == (expected.numerator, expected.denominator)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("gone_module_xyz:Tilt", "the model Tilt of the module 'gone_module_xyz' is needed and was not found"),
        ("greybox.models.tilt:Gone", "the model Gone of the module 'greybox.models.tilt' is needed and was not found"),
        ("greybox.models.tilt:gb", "its gb is not a Model"),
        ("math:sin", "its sin is not a Model"),
    ],
)
def test_a_model_that_is_gone_is_named_with_the_cure(name, words):
    with pytest.raises(LookupError, match=words) as caught:
        resolve({"class": name, "arguments": [], "keywords": {}})
    assert "model=..." in str(caught.value)


def test_a_model_defined_inside_a_function_is_gone_later():
    class Local(LagLagDelay):
        pass

    with pytest.raises(LookupError, match="Local"):
        resolve(json.loads(json.dumps(reference(Local()))))


def test_an_argument_that_is_no_plain_value_is_stored_as_text_and_said_to_be():
    stored = json.loads(json.dumps(reference(Configured({"a": 1}))))
    with pytest.raises(LookupError, match=r"\{'a': 1\}, was stored as text only: give model="):
        resolve(stored)
    assert resolve(json.loads(json.dumps(reference(Configured([1, "b", None]))))).thing == (1, "b", None)


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
