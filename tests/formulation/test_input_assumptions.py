"""How inputs run between samples: who says it, and what is said of it."""

import math

import numpy as np
import pytest

import greybox as gb
from greybox.data.intersample import Intersample
from greybox.formulation.input_assumptions import (
    assumption_warning,
    between_samples,
    described_inputs,
    effect_of,
    other_assumptions,
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


def test_where_the_record_knows_there_is_no_other_assumption():
    between = dict(zip(NAMES, between_samples("record", NAMES, record()), strict=True))
    assert other_assumptions("record", between, record()) == {"unknown": HELD}
    assert other_assumptions("record", {"constant": LINEAR}, record()) == {}
    stated = dict.fromkeys(NAMES, LINEAR)
    assert other_assumptions("linear", stated, record()) == {"held": HELD, "thinned": LATE}


def test_it_is_said_with_the_half_step_that_it_means():
    said = described_inputs("record", NAMES, record())
    assert said["held"] == "held until its next sample, as the record says"
    assert said["thinned"] == "interpolated, 1.25 ms late, as the record says"
    assert (
        said["unknown"] == "interpolated, an assumption, else delays differ by half a step, 10 ms"
    )
    assert described_inputs("held", ["unknown"], record())["unknown"].startswith(
        "held until its next sample, as stated"
    )


def test_the_effect_is_that_of_what_moves_and_of_delays():
    parameters = {
        "d": gb.Parameter(0.0, unit="s"),
        "k": gb.Parameter(0.0),
        "c": gb.Parameter(0.0, unit="1/s"),
    }
    shift, errors = np.array([0.01, 0.3, -1e-4]), np.array([1.0, 0.1, 0.01])
    assert effect_of(parameters, shift, errors, {"d"}) == (
        "moves k by +0.3 (3 standard errors) and d by +0.01 s (0.01 standard errors)"
    )
    assert effect_of(parameters, shift / 100, errors, ()) == ""
    assert (
        effect_of(parameters, shift * math.nan, errors, ())
        == "moves the estimate by an unknown amount"
    )


def test_another_word_is_refused():
    with pytest.raises(
        ValueError, match="inputs 'zoh' is not known: use 'linear' or 'held', or 'record' to follow"
    ):
        require_inputs("zoh")
    with pytest.raises(ValueError, match="inputs 'zoh' is not known"):
        gb.simulate(None, {}, record(), inputs="zoh")


@pytest.mark.parametrize(
    ("inputs", "names", "said"),
    [
        (
            "record",
            ["u"],
            "u is taken as interpolated between samples; the record does not say, and the data cannot tell, whether it "
            "is held, as the output of a controller is, which moves k: state it, OutputError(..., inputs='held') or "
            "'linear', or in the record, hold={'u': math.inf} or 0.",
        ),
        (
            "record",
            ["w", "u"],
            "w and u are taken as interpolated between samples; the record does not say, and the data cannot tell, "
            "whether they are held, as the output of a controller is, which moves k: state it, OutputError(..., "
            "inputs='held') or 'linear', or in the record, hold={'w': math.inf} or 0.",
        ),
        (
            "linear",
            ["u"],
            "the record says that u is held until its next sample, and OutputError takes it as interpolated: what the "
            "record says moves k; leave out inputs='linear' to follow it.",
        ),
        (
            "linear",
            ["u", "w"],
            "the record says that u and w are held until its next sample, and OutputError takes them as interpolated: "
            "what the record says moves k; leave out inputs='linear' to follow it.",
        ),
    ],
)
def test_the_warning_says_what_is_assumed_of_which_inputs_and_how_to_state_it(inputs, names, said):
    between = {"u": LINEAR, "w": LINEAR}
    assert (
        assumption_warning("OutputError", inputs, between, dict.fromkeys(names, HELD), "moves k")
        == said
    )


def test_four_parameters_are_named_at_most_those_with_the_largest_shifts_first():
    """A tenth of a standard error does not matter; one without an error counts by itself where it is a delay."""
    parameters = {name: gb.Parameter(0.0) for name in "abcdef"}
    shift = np.array([0.2, -0.3, 0.5, -0.4, 0.1, 7.0])
    said = effect_of(parameters, shift, np.array([1.0, 1, 1, 1, 1, 0]), {"f"})
    assert said == "moves c by +0.5 (0.5 standard errors), d by -0.4 (0.4 standard errors), " + (
        "b by -0.3 (0.3 standard errors) and a by +0.2 (0.2 standard errors)"
    )
    alone = effect_of({"f": gb.Parameter(0.0, unit="s")}, np.array([7.0]), np.zeros(1), {"f"})
    assert alone == "moves f by +7 s"
    assert effect_of({"e": gb.Parameter(0.0)}, np.array([0.1]), np.ones(1), ()) == ""


def test_rows_without_a_time_have_nothing_between_them():
    rows = gb.Record(None, {"u": np.arange(5.0)}, hold={"u": math.inf})
    assert between_samples("held", ["u"], rows) == (LINEAR,)
    assert described_inputs("held", ["u"], rows) == {}
    told = described_inputs("record", ["u"], gb.Record(TIME, {"u": TIME}))
    assert told == {"u": "interpolated, an assumption, else delays differ by half a step, 10 ms"}
    assert described_inputs("linear", ["u"], gb.Record(TIME, {"u": TIME}))["u"].startswith(
        "interpolated, as stated, e"
    )
    missing = gb.Record(TIME, {"u": np.full(10, np.nan)})
    assert other_assumptions("record", {"u": LINEAR}, missing) == {}
