"""A fit that failed says why, what came closest, what blocks it and what to try."""

import numpy as np
import pytest
from unfinished_runs import without_continued_runs
from unfolded import unfolded

import greybox as gb

N, STEP = 200, 0.1
TIME = STEP * np.arange(N)
U = np.repeat(np.random.default_rng(0).uniform(0, 1, N // 20), 20)
NOISE = 0.02 * np.random.default_rng(1).normal(size=N)


class Lag(gb.StateSpace):
    """A lag with an offset that nothing shows."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    a = gb.Parameter(1.0, bounds=(0.1, 10), unit="1/s")
    k = gb.Parameter(1.0, bounds=(0.1, 10))
    mass = gb.Parameter(1.0, bounds=(0.1, 10))
    held = gb.Parameter(0.5, fixed=True)

    def derivative(self, x, u, p):
        return (p.k * u.u - p.a * x.x + 0 * p.mass * p.held,)

    def output(self, x, u, p):
        return (x.x,)


class Root(gb.StateSpace):
    """A tank whose sensor gives a root of the level: data below zero drive it out of its domain."""

    states, inputs, outputs = ("h",), ("u",), ("y",)
    a = gb.Parameter(1.0, bounds=(0.01, 10))
    c = gb.Parameter(1.0, bounds=(0.01, 10))

    def derivative(self, x, u, p):
        return (p.a * u.u - p.c * gb.sqrt(x.h),)

    def output(self, x, u, p):
        return (gb.sqrt(x.h),)


def unfinished(criterion=gb.OutputError, iterations=4, tied=None, **start):
    clean = gb.simulate(Lag(), {"a": 3.0, "k": 20.0}, gb.Record(TIME, {"u": U}), inputs="held")["x"]
    problem = gb.Problem(
        Lag(),
        gb.Record(TIME, {"u": U, "x": clean + NOISE}),
        criterion(inputs="held"),
        tied=tied or {},
    )
    options = {"solver_options": {"max_iter": iterations}, "progress": False}
    with without_continued_runs():
        return gb.fit(problem, starts=[start], **options)


def test_the_best_end_is_given_without_errors_with_what_blocks_it():
    fit = unfinished()
    (run,) = fit.runs
    assert not fit.converged
    assert fit.status == "no start converged (1 × iterations exceeded)"
    assert fit.best_effort == dict(zip(fit.free, run.estimate.tolist(), strict=True)) | {
        "held": 0.5
    }
    assert np.isnan([fit.standard_error[name] for name in fit.free]).all()
    closest, *blocking = fit.warnings
    assert closest.startswith("run 0 came closest")
    assert "the option max_iter of the solver" in closest
    assert "leave out method" not in closest
    # The gain belongs at twice its upper bound, and nothing shows the mass.
    assert any(text.startswith("k ended at a bound") for text in blocking)
    assert any(text.startswith("mass is not determined") for text in blocking)
    said = unfolded(fit)
    assert all(text in said for text in fit.warnings)
    assert "best effort, no estimate" in said
    # From there the rest is found.
    problem = gb.Problem(
        Lag(), fit.records[0].data, gb.OutputError(inputs="held"), fixed={"mass": 1.0}
    )
    started = {name: fit.best_effort[name] for name in ("a", "k")}
    assert gb.fit(problem, starts=[started], progress=False).converged


def test_what_blocks_a_predictor_is_named_where_it_is_unstable_too():
    # Errors of the state grow by the sample; the nodes keep it near the data.
    fit = unfinished(gb.PredictionError, 2, K_x_x=2.5)
    assert abs(np.exp(-STEP * fit.best_effort["a"]) * (1 - fit.best_effort["K_x_x"])) > 1
    assert any(text.startswith("mass is not determined") for text in fit.warnings)


def test_a_failed_fit_says_how_its_best_end_is_simulated_which_works():
    fit = unfinished()
    record = fit.records[0].data
    with pytest.raises(ValueError, match=r"no estimate.*gb\.simulate\(model, fit\.best_effort"):
        gb.simulate(fit)
    motion = gb.simulate(Lag(), fit.best_effort, record=record)
    by_values = gb.simulate(Lag(), {n: fit.best_effort[n] for n in Lag.parameters}, record=record)
    assert np.array_equal(motion["x"], by_values["x"])


def test_tied_parameters_are_part_of_the_best_effort(tmp_path):
    """Without them a simulation from there would take their declared starts."""
    fit = unfinished(tied={"mass": lambda p: 2 * p.a + p.held})
    ended = fit.best_effort
    assert ended is not None
    assert ended["a"] != 1.0
    assert ended["mass"] == pytest.approx(2 * ended["a"] + 0.5)
    assert "mass" in str(fit).split("best effort, no estimate")[1]
    assert np.isnan(fit.estimate["mass"])
    gb.save(fit, tmp_path / "failed.h5")
    assert gb.load(tmp_path / "failed.h5").best_effort == ended


def test_an_estimate_leaves_no_best_effort():
    clean = gb.simulate(Lag(), {"a": 3.0, "k": 6.0}, gb.Record(TIME, {"u": U}), inputs="held")["x"]
    problem = gb.Problem(Lag(), gb.Record(TIME, {"u": U, "x": clean + NOISE}), fixed={"mass": 1.0})
    fit = gb.fit(problem, starts=1, progress=False)
    assert fit.converged
    assert fit.best_effort is None


def test_a_saved_failure_keeps_its_best_effort(tmp_path):
    fit = unfinished()
    gb.save(fit, tmp_path / "failed.h5")
    loaded = gb.load(tmp_path / "failed.h5")
    assert loaded.best_effort == fit.best_effort
    assert str(loaded) == str(fit)


def test_constraints_that_no_values_meet_are_named_with_their_value():
    omega = np.geomspace(0.1, 10, 12)
    response = gb.frequency_response(Lag(), {"a": 3.0, "k": 20.0}, omega)
    limits = [lambda p: p.a, lambda p: p.k - 11]  # k has the upper bound 10
    fixed = {"mass": 1.0}
    for data in (response, gb.Record(TIME, {"u": U, "x": U + NOISE})):
        fit = gb.fit(gb.Problem(Lag(), data, fixed=fixed, constraints=limits), starts=2)
        assert not fit.converged
        (said,) = (text for text in fit.warnings if text.startswith("constraints["))
        assert said.startswith("constraints[1] of 'Lag' is -")
        assert "must be at least 0" in said
