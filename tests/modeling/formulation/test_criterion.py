"""What all criteria share: names, and equality by type and settings."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from huber import Huber

import greybox as gb
from greybox.modeling.formulation.included_criteria import CRITERIA, TIME_CRITERIA

NAMES = {
    "relative-error": gb.RelativeError(),
    "relative-error:model": gb.RelativeError(normalized="model"),
    "squared-relative-error": gb.SquaredRelativeError(),
    "magnitude-phase": gb.MagnitudePhase(),
    "maximum-likelihood": gb.MaximumLikelihood(),
    "output-error": gb.OutputError(noise="full"),
    "prediction-error": gb.PredictionError(corrected=("v",)),
    "huber": Huber(2.0),
}


@pytest.mark.parametrize("name", NAMES)
def test_the_name_follows_from_the_class(name):
    assert NAMES[name].name == name


def test_the_included_criteria_have_names_of_their_own():
    names = [criterion.name for criterion in (*CRITERIA, *TIME_CRITERIA)]
    assert len(set(names)) == len(names)


def test_criteria_are_equal_by_class_and_settings():
    assert gb.RelativeError() == gb.RelativeError("measured") != gb.RelativeError("model")
    assert gb.RelativeError() != gb.SquaredRelativeError()
    assert gb.OutputError() != gb.PredictionError()
    assert gb.OutputError(noise={"x": 1, "v": 2}) == gb.OutputError(
        noise={"v": np.float64(2), "x": 1.0}
    )
    assert (
        gb.OutputError(biases="x") == gb.OutputError(biases=["x"]) != gb.OutputError(biases=("v",))
    )
    assert Huber(1) == Huber(1.0) != Huber(2.0)
    assert (
        len({gb.OutputError(noise={"x": 1}), gb.OutputError(noise={"x": 1.0}), gb.OutputError()})
        == 2
    )


def known(level):
    return gb.OutputError(initial={"x": lambda p: level * p.b})


def test_functions_among_the_settings_are_equal_by_their_source_and_what_they_capture():
    assert known(2.0) == known(2.0) != known(3.0)
    assert known(2.0) != gb.OutputError(initial={"x": lambda p: 2.0 * p.c})


def test_settings_are_plain():
    @dataclass(frozen=True, eq=False)
    class Odd(Huber):
        weights: object = None

    values = {"a": np.array([1.0, 2.0]), "b": {3, 1}, "c": (None, True), "d": np.int64(4), "e": 1j}
    settings = Odd(weights=values).settings
    assert settings["weights"] == {
        "a": [1.0, 2.0],
        "b": [1, 3],
        "c": [None, True],
        "d": 4,
        "e": "1j",
    }
    for criterion in (*NAMES.values(), known(2.0), Odd(weights=values)):
        assert json.loads(json.dumps(criterion.settings)) == criterion.settings


def test_what_costs_are_likelihoods():
    likely = {name for name, criterion in NAMES.items() if criterion.is_likelihood}
    assert likely == {"maximum-likelihood", "output-error", "prediction-error"}


def test_what_a_criterion_in_time_answers_about_itself():
    class Cart(gb.StateSpace):
        states, inputs, outputs = ("x", "v"), ("u",), ("x",)
        b = gb.Parameter(1.0)

        def derivative(self, x, u, p):
            return x.v, u.u - p.b * x.v

        def output(self, x, u, p):
            return (x.x,)

    assert gb.OutputError().gains(Cart(), ("x",)) == ()
    assert gb.PredictionError().gains(Cart(), ("x",)) == (("x", "x"), ("v", "x"))
    assert gb.PredictionError(corrected=("v",)).gains(Cart(), ("x",)) == (("v", "x"),)
    rules = gb.OutputError(), gb.PredictionError()
    assert [rule.corrects_states for rule in rules] == [False, True]


def test_settings_of_a_criterion_that_is_no_dataclass_are_its_public_values():
    class Plain(gb.Criterion):
        def __init__(self, share):
            self.share, self._cache = share, 7

        cost = jacobian = spread = None

    assert Plain(np.float64(0.25)).settings == {"share": 0.25}
    assert Plain(0.25) == Plain(0.25)
    assert Plain(0.25) != Plain(0.5)
