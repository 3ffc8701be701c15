"""The lines of an answer, word by word: what data there were, and how closely each output and response is followed."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.estimate.result import (
    Quantity,
    _best_effort_table,
    _biased,
    _data_text,
    _inputs_texts,
    _output_texts,
    _part_index,
    _prior_texts,
    _range,
    _response_texts,
    _rows,
    _spectrum_texts,
    _through,
    error_condition,
)


def response(off, name=""):
    """A response of ones at 1, 2, ... rad/s, with a model that is off by so much."""
    data = SimpleNamespace(response=np.ones(len(off), complex), omega=1.0 + np.arange(len(off)))
    return SimpleNamespace(data=data, response=1 + np.array(off), name=name)


def record(residual=(3.0, -4.0), percent=90.0, name="", unit="m", **more):
    given = {
        "outputs": ("y",),
        "fit_percent": lambda _: percent,
        "residual": lambda _: np.array(residual),
    }
    given |= {
        "data": SimpleNamespace(units={"y": unit}, name=name, has_time=True),
        "name": name,
        "rename": {},
    }
    return SimpleNamespace(**(given | more))


def test_responses_are_told_with_their_farthest_point():
    one = [response([0.03, -0.04j, 0.0])]
    assert _response_texts(one) == ["residual 2.9 % rms, largest 4 % at 2 rad/s"]
    two = [response([0.1], "hover"), response([0.0, 0.2])]
    assert _response_texts(two) == [
        "residual 10 % rms, largest 10 % at 1 rad/s (hover)",
        "residual 14 % rms, largest 20 % at 2 rad/s",
    ]
    many = [response([0.01 * k], f"r{k}") for k in range(1, 12)]
    assert _response_texts(many) == [
        f"residual {k} % rms, largest {k} % at 1 rad/s (r{k})" for k in (11, 10, 9)
    ]
    lost = response([0.1])
    lost.response[:] = np.nan
    assert _response_texts([lost]) == []


def test_records_are_told_one_by_one_and_of_many_the_range_and_the_worst():
    assert _output_texts([record(name="run")]) == ["y (run): residual 3.5355 m rms, fit 90.0 %"]
    assert _output_texts([record(percent=np.nan, unit="")]) == ["y: residual 3.5355 rms"]
    ten = [record() for _ in range(10)]
    assert len(_output_texts(ten)) == 10
    eleven = [record((k, -k), 100.0 - k, f"r{k}") for k in range(1, 12)]
    assert _output_texts(eleven) == [
        "y in 11 records: residual 1 to 11 m rms, fit 89.0 to 99.0 % (least: 89.0 % in record 11 (r11), 90.0 % in "
        "record 10 (r10), 91.0 % in record 9 (r9))"
    ]


@pytest.mark.parametrize(("values", "said"), [([2.0, 2.0001], "2"), ([3.0, 1.0, 2.0], "1 to 3")])
def test_a_range_is_one_number_where_its_ends_read_the_same(values, said):
    assert _range(values) == said


def test_manoeuvres_are_told_with_the_noise_of_a_sample_or_the_error_of_their_equation():
    def spectrum(criterion, name):
        data = SimpleNamespace(units={"q": "rad/s"})
        noise = np.diag([0.04, 0.0009])
        given = {
            "criterion": criterion,
            "name": name,
            "data": data,
            "noise": noise,
            "outputs": ("q", "az"),
        }
        return SimpleNamespace(fit_percent=lambda _: 87.65, **given)

    assert _spectrum_texts([spectrum("output-error", "a")]) == [
        "q: noise of a sample 0.2 rad/s, fit 87.7 %",
        "az: noise of a sample 0.03, fit 87.7 %",
    ]
    both = _spectrum_texts([spectrum("equation-error", "a"), spectrum("output-error", "")])
    assert both[0] == "q (a): error of its equation 0.2, fit 87.7 %"
    assert both[2] == "q: noise of a sample 0.2 rad/s, fit 87.7 %"


def test_data_are_counted_by_their_kind():
    def timed(count, compared, has_time=True):
        data = type("Data", (), {"__len__": lambda self: count, "has_time": has_time})()
        return SimpleNamespace(data=data, compared=compared)

    def counted(count):
        return SimpleNamespace(data=range(count))

    def text(**parts):
        return _data_text(
            SimpleNamespace(**({"responses": (), "spectra": (), "records": ()} | parts))
        )

    assert text(responses=[counted(1)]) == "1 point in 1 response"
    assert text(responses=[counted(3), counted(4)], spectra=[counted(9)]) == (
        "7 points in 2 responses and 9 lines in 1 manoeuvre"
    )
    assert text(records=[timed(100, 100), timed(50, 40)]) == "140 of 150 samples in 2 records"
    assert text(records=[timed(7, 7), timed(5, 5, has_time=False)]) == (
        "7 samples in 1 record and 5 rows without a time in 1 record"
    )


def test_inputs_that_ran_alike_share_a_line():
    one = record(name="a", between={"u": "held", "w": "held"})
    assert _inputs_texts([one]) == ["u, w held"]
    two = record(name="b", between={"u": "interpolated", "w": "held"})
    assert _inputs_texts([one, two]) == ["u held (a)", "u interpolated (b)", "w held"]


def quantity(name, value=2.0, error=0.1, kind="free", **more):
    return Quantity(name, value, error, kind, "s", f"of {name}", (0.0, 9.0), **more)


def test_rows_of_the_table_and_one_for_what_many_records_have_each_for_itself():
    lines = [
        quantity("k"),
        quantity("c", 9.0, np.nan, at_bound=True),
        quantity("f", 3.0, 0.0, "fixed"),
        *(quantity(f"b_{k}", k / 10, 0.01 * k, at_bound=k == 3) for k in range(1, 12)),
    ]
    records = [SimpleNamespace(rename={"b": f"b_{k}", "k": "k"}) for k in range(1, 12)]
    rows = _rows(SimpleNamespace(quantities=lines, records=records))
    assert rows[0] == ["k", "2.00", "0.10", "s", "[0, 9]", "", "of k"]
    assert rows[1][0] == "c"
    assert rows[1][3:] == ["s", "[0, 9]", "AT BOUND", "of c"]
    assert rows[2][3:] == ["s", "", "fixed", "of f"]
    assert rows[3] == [
        "b_1 ... b_11",
        "0.1 to 1.1",
        "0.01 to 0.11",
        "s",
        "[0, 9]",
        "1 AT BOUND",
        "of b_1",
    ]
    assert len(rows) == 4
    few = _rows(SimpleNamespace(quantities=lines, records=records[:10]))
    assert len(few) == 14


def test_biases_that_matter_are_named_the_largest_first():
    lines = [
        quantity("a", error=1.0, bias=0.29),
        quantity("b", error=1.0, bias=-0.5),
        quantity("c", error=0.1, bias=0.2),
        quantity("d", error=np.nan, bias=9.0),
    ]
    said = _biased(SimpleNamespace(quantities=lines))
    assert said == "; intervals are corrected for the bias by the noise (c -0.2 and b +0.5)"
    assert _biased(SimpleNamespace(quantities=lines[:1])) == ""


def test_what_depends_on_the_unknown_is_unknown():
    slope = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]])
    covariance = np.array([[4.0, 1.0, np.nan], [1.0, 9.0, np.nan], [np.nan] * 3])
    found = _through(slope, covariance)
    assert_allclose(found[:2, :2], slope[:2, :2] @ covariance[:2, :2] @ slope[:2, :2].T)
    assert np.isnan(found[2]).all()
    assert np.isnan(found[:, 2]).all()


def test_of_a_failed_fit_the_values_of_the_best_run_are_a_table_without_errors():
    lines = [
        quantity("k"),
        quantity("mass", 3.0, 0.0, "fixed"),
        quantity("d", 4.0, np.nan, "derived"),
    ]
    table = _best_effort_table(SimpleNamespace(quantities=lines), {"k": 2.5, "mass": 3.0})
    assert [line.rstrip() for line in table] == [
        "  parameter  value  unit  bounds         meaning",
        "  ---------  -----  ----  ------  -----  -------",
        "  k            2.5  s     [0, 9]         of k",
        "  mass           3  s             fixed  of mass",
    ]


def test_for_what_errors_the_standard_errors_hold():
    def said(dof, independent=None, conditions=("white", "even", "white")):
        parts = [SimpleNamespace(condition=each) for each in conditions]
        return error_condition(
            SimpleNamespace(parts=parts, independent=independent, dof=dof, quantities=())
        )

    assert said(np.inf) == "white; even"
    assert said(1.2) == "white; even; Student's t with 1 degree of freedom"
    assert said(7.6, (np.eye(1), 9.0), ("white",)) == (
        "white; correlated along frequency as far as the residuals are; Student's t with 8 degrees of freedom"
    )


def test_what_was_known_before_is_told_with_its_share():
    fit = SimpleNamespace(priors={"k": (2.0, 0.1), "c": (5.0, 2.0)}, prior_share={"k": 0.25})
    assert [*_prior_texts(fit)] == [
        "k = 2.00 ± 0.10 (25 %) and c = 5.0 ± 2.0 (- %): maximum a posteriori, with the share that the prior has in "
        "what is known of each"
    ]
    assert [*_prior_texts(SimpleNamespace(priors={}))] == []


def test_the_part_that_is_meant_is_the_one_asked_for_or_the_record_or_the_first_of_the_model():
    class Model(gb.StateSpace):
        inputs, outputs = ("u",), ("y",)
        k = gb.Parameter(1.0)

        def output(self, x, u, p):
            return (p.k * u.u,)

    class Other(Model):
        pass

    def part(data, model=None, is_prior=False):
        name = type(model or Other()).__qualname__
        return SimpleNamespace(data=data, is_prior=is_prior, model={"class": f"elsewhere:{name}"})

    flights = [
        gb.Record(np.arange(4.0), {"u": np.arange(4.0) + k, "y": np.ones(4) * k}) for k in (0, 1, 2)
    ]
    response = gb.FrequencyResponse([1.0], [2.0])
    parts = [
        part(flights[2], is_prior=True),
        part(response),
        part(flights[0]),
        part(flights[1], Model()),
        part(response),
    ]
    fit = SimpleNamespace(parts=parts)
    assert [_part_index(fit, None, k, None) for k in (0, 4, -1, -5)] == [0, 4, 4, 0]
    for wrong in (5, -6, True, 1.0):
        with pytest.raises(
            ValueError, match=rf"^part is {wrong!r}: the fit has 5 parts, counted from 0\.$"
        ):
            _part_index(fit, None, wrong, None)
    assert _part_index(fit, None, None, None) == 2  # records before responses
    assert _part_index(fit, None, None, flights[1]) == 3
    assert _part_index(fit, Model(), None, flights[0]) == 3
    assert _part_index(fit, Other(), None, flights[1]) == 2
    assert (
        _part_index(SimpleNamespace(parts=parts[:2]), None, None, None) == 1
    )  # what is known before is no data
    assert _part_index(SimpleNamespace(parts=parts[:2]), Model(), None, flights[0]) == 1
