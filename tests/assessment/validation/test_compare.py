"""Comparisons say what is true of data whose truth is known, and the tests behind them have their nominal size."""

import json

import numpy as np
import pytest
from drag_flights import LINEAR, QUADRATIC, Drag, LinearDrag, QuadraticDrag, fitted, flight

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


@pytest.fixture(scope="module")
def quadratic():
    """Nonlinear truth: the quadratic and the linear model fitted to one flight, and another flight."""
    record = flight(QUADRATIC, 1)
    assert np.ptp(record["v"]) > 5
    return fitted(QuadraticDrag(), record), fitted(LinearDrag(), record), flight(QUADRATIC, 2)


def test_a_quadratic_truth_is_told_on_records_that_were_held_out(quadratic):
    right, wrong, other = quadratic
    found = gb.compare(wrong, right, records=other)
    text = str(found)
    assert "QuadraticDrag predicts held-out data better than LinearDrag" in text
    assert "QuadraticDrag predicts the identification data better than LinearDrag" in text
    for place in ("identification", "held-out"):
        fits = [found.value("fit", name, place, "v") for name in found.labels]
        assert fits[1] > fits[0] + 0.5
        assert found.value("  white (p)", "QuadraticDrag", place, "v") > 0.01
        assert found.value("  white (p)", "LinearDrag", place, "v") < 0.001
        assert found.value(
            "one step ahead: error over noise", "QuadraticDrag", place, "v"
        ) == pytest.approx(1, abs=0.1)
    assert found.value("AIC less the least", "QuadraticDrag") == 0


def test_a_linear_truth_is_not_taken_for_a_quadratic_one():
    record, other = flight(LINEAR, 3), flight(LINEAR, 4)
    both, linear, quadratic = (fitted(m, record) for m in (Drag(), LinearDrag(), QuadraticDrag()))
    found = gb.compare(both, linear, records=other)
    assert "C_x is not shown to be needed" in found.verdict
    assert found.supported == "LinearDrag"
    assert "equally well" in str(found)
    found = gb.compare(quadratic, linear, records=[other])
    assert "LinearDrag predicts the identification data better than QuadraticDrag" in str(found)


def test_slow_flight_does_not_determine_the_quadratic_term():
    record, other = (
        flight({"a5": 0.3, "C_x": 0.05}, seed, noise=0.1, amplitude=0.004) for seed in (5, 6)
    )
    found = gb.compare(fitted(Drag(), record), fitted(LinearDrag(), record), records=other)
    assert "C_x" in found.verdict
    assert "The data do not show" in found.verdict


def test_a_comparison_does_not_contradict_the_nested_test():
    # A term of three to six standard errors.
    significant = 0
    for seed in range(60, 63):
        record = flight({"a5": 0.2, "C_x": 0.05}, seed, duration=15.0, noise=0.25)
        small, large = fitted(LinearDrag(), record), fitted(Drag(), record)
        test = gb.validation.nested_test(small, large)
        found = gb.compare(*((small, large) if seed % 2 else (large, small)))
        assert str(test) in found.verdict
        significant += test.p_value < 0.05
    assert significant >= 2


def test_too_few_held_out_windows_take_nothing_from_what_the_fits_show(quadratic):
    right, wrong, other = quadratic
    found = gb.compare(right, wrong, records=other.between(0, 2.5), window=1.0)
    assert "2 windows cannot show which of QuadraticDrag and LinearDrag" in str(found)
    assert "QuadraticDrag predicts the identification data better than LinearDrag" in str(found)


def test_the_table_is_plain(quadratic):
    found = gb.compare(*quadratic[:2], records=quadratic[2], labels=("a", "b"))
    assert json.loads(json.dumps(found.table, allow_nan=False)) == found.table
    assert found.table[0]["values"].keys() == {"a", "b"}
    with pytest.raises(ValueError, match="there is no 'speed' of 'a'"):
        found.value("speed", "a")


def test_a_record_that_a_fit_has_seen_is_told(quadratic):
    right, wrong, _ = quadratic
    found = gb.compare(right, wrong, records=right.parts[0].data)
    assert (
        "warning: flight 1 is not held out: QuadraticDrag was fitted to samples of it."
        in found.statements
    )


def test_other_data_are_refused_and_judged_by_records_alone(quadratic):
    right, _, other = quadratic
    elsewhere = fitted(LinearDrag(), other)
    with pytest.raises(
        ValueError,
        match=r"LinearDrag was fitted to other data \('flight 2', .*\) than QuadraticDrag \(",
    ):
        gb.compare(right, elsewhere)
    # A stretch of one log has the checksum of the whole log.
    half = fitted(LinearDrag(), right.parts[0].data.between(0, 10))
    with pytest.raises(ValueError, match="was fitted to other data"):
        gb.compare(right, half)
    found = gb.compare(right, elsewhere, records=flight(QUADRATIC, 7))
    assert "their costs are not compared" in found.data
    assert found.value("AIC", "LinearDrag") is None
    assert found.value("fit", "QuadraticDrag", "held-out", "v") > found.value(
        "fit", "LinearDrag", "held-out", "v"
    )


@pytest.mark.parametrize(
    ("call", "error", "sentence"),
    [
        (lambda a, b, r: gb.compare(a), ValueError, "there is 1 fit to compare"),
        (lambda a, b, r: gb.compare(a, r), TypeError, "give fits"),
        (
            lambda a, b, r: gb.compare(a, b, labels=("x", "x")),
            ValueError,
            "give a list of 2 different texts",
        ),
        (
            lambda a, b, r: gb.compare(a, b, labels="ab"),
            ValueError,
            "labels is 'ab': give a list of 2",
        ),
        (
            lambda a, b, r: gb.compare(a, b, window="x"),
            ValueError,
            "window is 'x': give a length above 0, in s",
        ),
        (
            lambda a, b, r: gb.compare(a, b, window=-1.0),
            ValueError,
            "window is -1.0: give a length above 0",
        ),
        (
            lambda a, b, r: gb.compare(a, b, lead=np.inf),
            ValueError,
            "lead is inf: give a length above 0",
        ),
        (
            lambda a, b, r: gb.compare(a, b, window=100.0),
            ValueError,
            "no room for lead=0.5 and window=100 s",
        ),
        (
            lambda a, b, r: gb.compare(a, b, records="r.csv"),
            TypeError,
            "records is 'r.csv': give a Record or a list",
        ),
        (
            lambda a, b, r: gb.compare(a, b, records=3),
            TypeError,
            "records is 3: give a Record or a list",
        ),
        (
            lambda a, b, r: gb.compare(a, b, records=[r, a]),
            TypeError,
            "give a Record or a list of them",
        ),
        (
            lambda a, b, r: gb.compare(a, b, records=gb.Record(r.time, {"theta": r["theta"]})),
            ValueError,
            "no output",
        ),
        (
            lambda a, b, r: gb.compare(a, b, records=gb.Record(r.time, {"v": r["v"]})),
            ValueError,
            "no signal 'theta', an input",
        ),
        (
            lambda a, b, r: gb.validation.nested_test(a, b),
            ValueError,
            "is not shown to be LinearDrag with terms removed",
        ),
    ],
)
def test_mistakes_are_told_in_a_sentence(quadratic, call, error, sentence):
    with pytest.raises(error) as caught:
        call(*quadratic)
    assert sentence in str(caught.value)
