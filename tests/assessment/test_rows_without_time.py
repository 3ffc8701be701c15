"""Static models and rows that have no order in time, held against linear regression in closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest
from calibration_rows import Lag, Line, Parabola, least_squares, rows
from scipy.stats import f as f_distribution, t as student_t
from unfolded import unfolded

import greybox as gb


def fitted(model, record, **options):
    return gb.fit(gb.Problem(model, record, **options), starts=2, progress=False)


def test_estimates_and_errors_are_those_of_linear_regression():
    record = rows()
    fit = fitted(Line(), record)
    values, errors, _ = least_squares(record)
    assert list(fit.estimate.values()) == pytest.approx(values, rel=1e-7)
    assert list(fit.standard_error.values()) == pytest.approx(errors, rel=1e-6)
    assert fit.dof == 12
    half = student_t.ppf(0.975, 12) * errors[1]
    assert fit.interval()["b"] == pytest.approx((values[1] - half, values[1] + half), rel=1e-6)
    assert fit.warnings == ()


def test_the_order_of_the_rows_is_none():
    """Sorted by their residuals, neighbors are alike: in time that would be a drift, and widen the errors."""
    record = rows(40)
    residual = record["y"] - 2 - 3 * record["x"]
    order = np.argsort(residual)
    shuffled, sorted_ = fitted(Line(), record), fitted(Line(), record.rows(order))
    assert sorted_.standard_error == pytest.approx(shuffled.standard_error, rel=1e-6)
    assert sorted_.warnings == ()

    drifting = gb.Record(np.arange(40.0), {name: record[name][order] for name in ("x", "y")})
    in_time = fitted(Line(), drifting)
    assert in_time.standard_error["a"] > 1.5 * sorted_.standard_error["a"]
    assert "autocorrelation" in str(in_time)


def test_several_outputs_have_variances_of_their_own():
    class Two(Line):
        outputs = ("y", "z")
        d = gb.Parameter(1.0, starts=(-5, 5))

        def output(self, x, u, p):
            return (p.a + p.b * u.x, p.d * u.x)

    one, other = rows(500, 1), rows(500, 2)
    z = 0.7 * one["x"] + 5 * (other["y"] - 2 - 3 * other["x"])
    fit = fitted(Two(), one.with_signals(z=z))
    assert fit.standard_error["a"] == pytest.approx(least_squares(one)[1][0], rel=0.01)
    sigma = np.std(z - fit.estimate["d"] * one["x"])
    assert fit.standard_error["d"] == pytest.approx(sigma / np.linalg.norm(one["x"]), rel=0.01)


def test_what_is_printed_says_rows_and_nothing_of_time(tmp_path):
    fit = fitted(Line(), rows())
    text = unfolded(fit)
    assert "14 rows without a time in 1 record" in text
    assert "for independent errors of equal variance in each output" in text
    for word in ("autocorrelation", "PredictionError", "interpolated", "held", "sample"):
        assert word not in text
    gb.save(fit, tmp_path / "rows.h5")
    loaded = gb.load(tmp_path / "rows.h5")
    assert unfolded(loaded) == text
    assert not loaded.records[0].data.has_time


def test_a_static_model_in_time_has_no_advice_on_inputs_between_samples():
    record = rows(60, time=0.1 * np.arange(60))
    text = str(fitted(Line(), record))
    assert "60 samples in 1 record" in text
    assert "between samples" not in text
    assert "inputs  " not in text


def test_rows_with_missing_values_are_left_out_alone():
    record = rows(20)
    x, y = record["x"].copy(), record["y"].copy()
    x[1::4] = np.nan
    y[2] = np.nan
    kept = np.isfinite(x) & np.isfinite(y)
    fit = fitted(Line(), record.with_signals(x=x, y=y))
    values, errors, _ = least_squares(record.rows(np.flatnonzero(kept)))
    assert list(fit.estimate.values()) == pytest.approx(values, rel=1e-7)
    assert list(fit.standard_error.values()) == pytest.approx(errors, rel=1e-6)
    assert fit.records[0].compared == kept.sum()
    assert np.array_equal(np.isfinite(fit.records[0].residual("y")), kept)

    # A static model needs no neighbors in time either.
    timed = gb.Record(np.arange(20.0), {"x": x, "y": y})
    assert fitted(Line(), timed).records[0].compared == kept.sum()


def test_as_many_rows_as_unknowns_fit_exactly_without_errors():
    fit = fitted(Line(), rows(2))
    assert list(fit.estimate.values()) == pytest.approx(least_squares(rows(2))[0], rel=1e-6)
    assert all(math.isnan(error) for error in fit.standard_error.values())
    (said,) = fit.warnings
    assert said.startswith(
        "2 real numbers of data for 2 unknowns leave no degrees of freedom, so that no standard err"
    )
    assert "±" not in str(fit).replace("± error", "")


def test_two_rows_for_one_unknown_have_errors_with_one_degree_of_freedom():
    for time in (None, np.arange(2.0)):
        record = rows(2, time=time)
        fit = fitted(Line(), record, fixed={"a": 2.0})
        x, y = record["x"], record["y"] - 2
        slope = (x @ y) / (x @ x)
        assert fit.estimate["b"] == pytest.approx(slope, rel=1e-7)
        if time is None:
            error = np.linalg.norm(y - slope * x) / np.linalg.norm(x)
            assert fit.standard_error["b"] == pytest.approx(error, rel=1e-5)
            assert fit.dof == 1


def test_one_row_determines_a_combination():
    fit = fitted(Line(), rows(1))
    assert (
        "are not determined: at this estimate the data depend only on a combination of them"
        in fit.warnings[0]
    )
    assert fitted(Line(), rows(1), fixed={"b": 3.0}).estimate["a"] == pytest.approx(
        rows(1)["y"][0] - 3 * rows(1)["x"][0]
    )


def test_repeated_inputs_are_a_mean():
    record = gb.Record(None, {"x": np.full(5, 0.3), "y": np.array([1.0, 1.2, 0.9, 1.1, 1.05])})
    fit = fitted(Line(), record, fixed={"b": 0.0})
    assert fit.estimate["a"] == pytest.approx(np.mean(record["y"]))
    assert fit.standard_error["a"] == pytest.approx(
        np.std(record["y"], ddof=1) / math.sqrt(5), rel=1e-6
    )
    assert fit.warnings == ()

    class Constant(gb.StateSpace):
        inputs = ()
        a = gb.Parameter(1.0, starts=(-5, 5))

        def output(self, x, u, p):
            return (p.a,)

    for time in (None, np.arange(5.0)):
        alone = fitted(Constant(), gb.Record(time, {"y": record["y"]}))
        assert alone.estimate["a"] == pytest.approx(np.mean(record["y"]))
        assert alone.warnings == ()


def test_no_row_with_input_and_output_is_a_sentence():
    record = gb.Record(
        None, {"x": np.array([1.0, np.nan, 2.0]), "y": np.array([np.nan, 1.0, np.nan])}
    )
    with pytest.raises(
        ValueError, match=r"the record has no row with all inputs and an output \(x; y\)"
    ):
        fitted(Line(), record)


def test_an_output_that_never_changes_is_fitted_exactly():
    for size in (1e-9, 5.0):
        record = gb.Record(None, {"x": np.array([0.0, 1.0, 2.0]), "y": np.full(3, size)})
        fit = fitted(Line(), record)
        assert fit.estimate["a"] == pytest.approx(size, rel=1e-5)
        assert "nan" not in str(fit)


def test_a_model_that_explains_nothing_is_said_without_reference_to_samples():
    record = rows(50, noise=1.0)
    (said,) = fitted(Line(), record.with_signals(y=record["y"] - 3 * record["x"])).warnings
    assert said.startswith("the model reproduces almost none of the variation of y")


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (
            lambda: gb.Problem(Lag(), rows()),
            "the dynamic model Lag needs samples in time, and calibration has rows",
        ),
        (lambda: gb.simulate(Lag(), {}, rows()), "the dynamic model Lag needs samples in time"),
        (lambda: gb.predict(Lag(), {}, rows()), "the dynamic model Lag needs samples in time"),
        (
            lambda: gb.Problem(Line(), rows(), gb.PredictionError()),
            r"Line declares no states, .*: use OutputError\(\)",
        ),
        (lambda: gb.prepare(rows(), {"x": "x"}), "prepare needs samples in time"),
        (
            lambda: gb.spectral.spectral_response(rows(), input="x", output="y"),
            "a frequency response needs samples in time",
        ),
        (lambda: gb.spectral.check(rows(), input="x", output="y"), "a test needs samples in time"),
        (
            lambda: gb.regression.equation_error(Lag(), rows()),
            "equation_error needs samples in time",
        ),
        (lambda: rows().between(0, 3), "between needs samples in time"),
    ],
)
def test_what_needs_a_time_is_refused_in_a_sentence(ask, words):
    with pytest.raises(ValueError, match=words):
        ask()


def test_a_simulation_of_rows_has_the_errors_of_the_line():
    record = rows()
    fit = fitted(Line(), record)
    new = gb.Record(None, {"x": np.array([-2.0, np.nan, 2.0])})
    simulated = gb.simulate(fit, record=new)
    values, _, squares = least_squares(record)
    A = np.vander(record["x"], 2, increasing=True)
    C = np.linalg.inv(A.T @ A) * squares / 12
    expected = [math.sqrt(np.array([1, x]) @ C @ np.array([1, x])) for x in (-2.0, 2.0)]
    assert simulated["y"][[0, 2]] == pytest.approx(values[0] + values[1] * np.array([-2.0, 2.0]))
    assert simulated["y_error"][[0, 2]] == pytest.approx(expected, rel=1e-5)
    assert np.isnan(simulated["y"][1])
    assert not simulated.has_time


def test_a_prediction_takes_every_row_by_itself():
    fit = fitted(Line(), rows())
    other = rows(30, 7)
    made = gb.predict(fit, record=other)
    expected = fit.estimate["a"] + fit.estimate["b"] * other["x"]
    assert made.predicted[0].ravel() == pytest.approx(expected)
    assert made.rms("y") == pytest.approx(np.sqrt(np.mean((other["y"] - expected) ** 2)))
    assert str(made).startswith("Line: 30 rows of calibration\n")
    plain = gb.predict(Line(), {"a": 2.0, "b": 3.0}, other)
    assert plain.noise[0, 0] == pytest.approx(np.mean((other["y"] - 2 - 3 * other["x"]) ** 2))


def test_nested_models_are_tested_by_the_f_test_of_least_squares():
    for c, needed in ((0.0, False), (1.0, True)):
        record = rows(9, 3, c=c)
        fits = [fitted(model, record) for model in (Line(), Parabola())]
        test = gb.validation.nested_test(*fits)
        before, after = (least_squares(record, degree)[2] for degree in (1, 2))
        F = (before - after) / (after / 6)
        assert test.statistic == pytest.approx(F, rel=1e-4)
        assert test.p_value == pytest.approx(f_distribution.sf(F, 1, 6), rel=1e-4)
        assert (test.p_value < 0.05) == needed
        assert "in time" not in str(test)

        given = [
            fitted(model, record, criterion=gb.OutputError(noise={"y": 0.3}))
            for model in (Line(), Parabola())
        ]
        assert gb.validation.nested_test(*given).statistic == pytest.approx(F, rel=1e-4)


def test_a_comparison_judges_rows_one_by_one():
    train, held_out = rows(20, 3, c=1.0), rows(40, 4, c=1.0)
    fits = [fitted(model, train) for model in (Line(), Parabola())]
    found = gb.compare(*fits, records=held_out)
    text = str(found)
    assert "Parabola predicts held-out data better than Line" in text
    assert "of 40 rows" in text
    assert "held-out data: 40 rows, each by itself" in text
    for word in ("ahead", "white", "window", "lags"):
        assert word not in text
    rms = found.value("error (rms)", "Line", "held-out", "y")
    expected = fits[0].estimate["a"] + fits[0].estimate["b"] * held_out["x"]
    assert rms == pytest.approx(np.sqrt(np.mean((held_out["y"] - expected) ** 2)))


def test_rows_of_one_table_are_the_same_data():
    whole = replace(rows(20), checksum="table")
    fits = [fitted(model, whole.rows(np.arange(12))) for model in (Line(), Parabola())]
    assert "is not held out" in str(gb.compare(*fits, records=whole.rows(np.arange(10, 20))))
    assert "is not held out" not in str(gb.compare(*fits, records=whole.rows(np.arange(12, 20))))


def test_tables_and_records_in_time_add():
    table, record = rows(20), rows(30, 5, time=0.1 * np.arange(30))
    fit = gb.fit(gb.Problem(Line(), table) + gb.Problem(Line(), record), starts=1, progress=False)
    assert "20 rows without a time in 1 record and 30 samples in 1 record" in str(fit)
    assert fit.estimate["b"] == pytest.approx(3, abs=4 * fit.standard_error["b"])


def test_a_figure_has_a_dot_for_each_row():
    from greybox.reporting.plotting import time_history

    fit = fitted(Line(), rows())
    places = time_history(fit)
    assert places[-1].get_xlabel() == "Row"
    fitted_line_ = places[0].lines[-1]
    assert fitted_line_.get_linestyle() == "None"
    drawn = fitted_line_.get_ydata()
    assert np.array_equal(drawn[np.isfinite(drawn)], fit.records[0].simulated["y"])
    time_history(gb.predict(fit, record=rows(30, 7)))
    gb.plot(fit)


def test_several_tables_share_a_slope():
    """By least squares with a constant for each table, weighted by the variances that were found."""
    tables = [rows(20, k, noise=0.05 * (k + 1)) for k in range(3)]
    fit = gb.fit(gb.several(Line(), tables, own=["a"]), starts=1, progress=False)
    weights = np.repeat([1 / np.sqrt(part.noise[0, 0]) for part in fit.records], 20)
    A = np.hstack(
        [np.concatenate([t["x"] for t in tables])[:, None], np.kron(np.eye(3), np.ones((20, 1)))]
    )
    y = np.concatenate([t["y"] for t in tables])
    q, _, _, _ = np.linalg.lstsq(A * weights[:, None], y * weights, rcond=None)
    assert [fit.estimate[name] for name in ("b", "a_1", "a_2", "a_3")] == pytest.approx(q, rel=1e-6)
    error = np.sqrt(np.linalg.inv((A.T * weights**2) @ A)[0, 0])
    assert fit.standard_error["b"] == pytest.approx(
        error, rel=0.1
    )  # each variance has degrees of freedom of its own


def test_parts_that_are_not_tested_for_missing_terms_are_named():
    class Slope(gb.TransferFunction):
        b = gb.Parameter(1.0, bounds=(0, 10))

        def response(self, s, p):
            return p.b / (1 + 0.1 * s)

    table = gb.Problem(Line(), rows(), gb.OutputError(noise={"y": 0.1}), name="bench")
    omega = np.logspace(-1, 1, 12)
    flown = gb.FrequencyResponse(
        omega, 3 / (1 + 0.1j * omega), variance=np.full(12, 1e-4), name="flight"
    )
    fit = gb.fit(table + gb.Problem(Slope(), flown, gb.MaximumLikelihood()), starts=1)
    assert fit.misfit.explains
    assert "not tested for candidate terms in bench" in str(fit)
