"""How inputs run between samples: who says it, and what is said of it."""

import math

import numpy as np
import pytest

import greybox as gb
from greybox.data.intersample import Intersample
from greybox.modeling.formulation.input_assumptions import (
    between_samples,
    described_inputs,
    require_inputs,
)

TIME = np.arange(10) / 50
NAMES = ("held", "sampled", "thinned", "unknown")
HELD, LINEAR, LATE = Intersample(True), Intersample(False), Intersample(False, 0.00125)


def record():
    signals = dict.fromkeys((*NAMES, "constant"), np.sin(TIME)) | {"constant": np.ones(10)}
    return gb.Record(TIME, signals, hold={"held": math.inf, "sampled": 0.0, "thinned": 0.0025})


def test_the_record_says_it_and_what_it_does_not_know_is_interpolated():
    assert between_samples("record", NAMES, record()) == (HELD, LINEAR, LATE, LINEAR)
    assert between_samples("record", NAMES, record(), {"unknown": math.inf, "sampled": math.inf})[
        1::2
    ] == (
        LINEAR,
        HELD,
    )


def test_the_user_overrules_it():
    assert between_samples("held", NAMES, record()) == (HELD,) * 4
    assert between_samples("linear", NAMES, record()) == (LINEAR,) * 4


def test_it_is_said_with_the_half_step_that_it_means():
    said = described_inputs("record", NAMES, record())
    assert said["held"] == "held until the next sample, as the record says"
    assert said["thinned"] == "interpolated, 1.25 ms late, as the record says"
    assert (
        said["unknown"]
        == "interpolated, as assumed without a hold; if wrong, delays change by half a step, 10 ms"
    )
    assert described_inputs("held", ["unknown"], record())["unknown"].startswith(
        "held until the next sample, as stated"
    )


class Lag(gb.StateSpace):
    states, inputs, outputs = ("x",), ("held",), ("x",)

    def derivative(self, x, u, p):
        return (u.held - x.x,)

    def output(self, x, u, p):
        return (x.x,)


def test_another_word_is_refused():
    with pytest.raises(
        ValueError, match="inputs 'zoh' is not known: use 'linear' or 'held', or 'record' to follow"
    ):
        require_inputs("zoh")
    with pytest.raises(ValueError, match="inputs 'zoh' is not known"):
        gb.simulate(Lag(), {}, record(), inputs="zoh")


def test_rows_without_a_time_have_nothing_between_them():
    rows = gb.Record(None, {"u": np.arange(5.0)}, hold={"u": math.inf})
    assert between_samples("held", ["u"], rows) == (LINEAR,)
    assert described_inputs("held", ["u"], rows) == {}
    told = described_inputs("record", ["u"], gb.Record(TIME, {"u": TIME}))
    assert told == {
        "u": "interpolated, as assumed without a hold; if wrong, delays change by half a step, 10 ms"
    }
    assert described_inputs("linear", ["u"], gb.Record(TIME, {"u": TIME}))["u"].startswith(
        "interpolated, as stated; if wrong"
    )
