"""Errors that replicates of a record draw, against those of a mean."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.covariance.covariance import accuracy_at
from greybox.workflows.study.record_replicates import RecordReplicates, record_draws

VALUES = 2 + 0.1 * np.random.default_rng(1).normal(size=12)


class Ramp(gb.StateSpace):
    """A constant in time."""

    states, inputs, outputs = (), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.K * u.u,)


def draws_of(values=VALUES):
    record = gb.Record(np.arange(len(values)) / 10, {"u": np.ones(len(values)), "y": values})
    nlp = compile_problem(gb.Problem(Ramp(), record))
    (part,) = nlp.parts
    x = np.array([np.nanmean(values)])
    return white_draws(nlp, x, (part.trajectory(nlp.scaling.to_solver(x)),))


def white_draws(nlp, x, trajectories, seed=0):
    """Draws of errors that are taken as white, however they are correlated."""
    accuracy = accuracy_at(nlp, x, trajectories)
    white = tuple(
        replace(errors, colored=None, numbers=part.numbers - len(x) / len(nlp.parts))
        for errors, part in zip(accuracy.parts, accuracy.informations, strict=True)
    )
    return record_draws(replace(accuracy, parts=white), seed)


def test_drawn_errors_have_the_variance_with_n_less_one_degrees_of_freedom():
    draws = draws_of()
    (fitted,) = draws.parts[0].fitted
    assert_allclose(draws.parts[0].residuals.std(), np.std(VALUES, ddof=1))
    assert_allclose(fitted, VALUES.mean())
    # Any of the residuals may be drawn.
    drawn = np.hstack([next(draws.of(number)[1])[0][0] for number in range(20)]) - fitted[0, 0]
    (residuals,) = draws.parts[0].residuals
    assert_allclose(np.abs(residuals[:, None] - drawn).min(axis=1), 0, atol=1e-9)


@pytest.mark.parametrize("missing", ["a third", "at random"])
def test_drawn_errors_that_are_correlated_move_the_estimate_as_far_as_theory_says(missing):
    """The coefficient of half a cosine under errors of an AR(1): blocks of residuals made its error 0.72 of that."""
    n, fade = 300, 0.8
    t, random = np.arange(n), np.random.default_rng(8)
    there = abs(t - 120) > 50 if missing == "a third" else random.random(n) < 0.7
    u = np.cos(np.pi * t / n)
    row = np.where(there, u, 0.0) / np.sum(u[there] ** 2)
    expected = np.sqrt(row @ (fade ** abs(t - t[:, None]) / (1 - fade**2)) @ row)
    logarithms = []
    for _ in range(12):
        y = u + lfilter([1], [1, -fade], random.normal(size=n + 100))[100:]
        record = gb.Record(t / 10, {"u": u, "y": np.where(there, y, np.nan)})
        nlp = compile_problem(gb.Problem(Ramp(), record))
        estimate = np.array([row @ y])
        trajectories = (nlp.parts[0].trajectory(nlp.scaling.to_solver(estimate)),)
        draws = record_draws(accuracy_at(nlp, estimate, trajectories), 0)
        errors = [row @ np.nan_to_num(next(draws.of(number)[1])[0][0]) for number in range(60)]
        logarithms.append(np.log(np.std(errors) / expected))
    assert_allclose(np.exp(np.mean(logarithms)), 1, atol=0.15)


def test_missing_samples_stay_missing_and_do_not_count():
    values = np.where(np.arange(12) % 3 == 1, np.nan, VALUES)
    draws = draws_of(values)
    assert_allclose(np.nanstd(draws.parts[0].residuals), np.nanstd(values, ddof=1))
    for number in range(5):
        ((drawn,),) = draws.of(number)[1]
        assert np.isnan(drawn[0]).tolist() == np.isnan(values).tolist()


def levels():
    """Five records of a constant that differs between them, and their solver's begin."""
    random = np.random.default_rng(2)
    values = [2 + 0.3 * k + 0.1 * random.normal(size=20 + 5 * k) for k in range(5)]
    records = [gb.Record(np.arange(v.size) / 10, {"u": np.ones(v.size), "y": v}) for v in values]
    nlp = compile_problem(gb.several(Ramp(), records))
    start = nlp.scaling.to_solver(np.array([2.0]))
    return records, nlp, start, tuple(part.trajectory(start) for part in nlp.parts)


def test_replicates_of_several_records_are_the_same_where_the_problem_was_left_behind():
    _, nlp, start, trajectories = levels()
    draws = white_draws(nlp, np.array([2.0]), trajectories)
    here = RecordReplicates(nlp, draws, start, tuple(t.nodes for t in trajectories))
    there = pickle.loads(pickle.dumps(here))
    assert_allclose(
        there.run(np.array([3.0])).estimate, here.run(np.array([3.0])).estimate, rtol=1e-12
    )


class Pair(gb.StateSpace):
    """A constant that two sensors see."""

    states, inputs, outputs = (), ("u",), ("y", "z")
    K = gb.Parameter(1.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.K * u.u, 3 * p.K * u.u)


def pair_draws(missing=(), noise="full"):
    random = np.random.default_rng(4)
    errors = np.linalg.cholesky([[0.04, -0.03], [-0.03, 0.09]]) @ random.normal(size=(2, 30))
    u = 1 + 0.1 * np.arange(30)
    y, z = 2 * u + errors[0], 6 * u + errors[1]
    y[list(missing)] = np.nan
    nlp = compile_problem(
        gb.Problem(
            Pair(),
            gb.Record(np.arange(30) / 10, {"u": u, "y": y, "z": z}),
            gb.OutputError(noise=noise),
        )
    )
    x = np.array([2.0])
    trajectory = nlp.parts[0].trajectory(nlp.scaling.to_solver(x))
    return white_draws(nlp, x, (trajectory,), 5), np.array([y - 2 * u, z - 6 * u])


def test_residuals_are_enlarged_for_the_fitted_parameters():
    """One parameter of sixty numbers."""
    draws, errors = pair_draws()
    expected = np.sqrt(60 / 59) * (errors - errors.mean(axis=1, keepdims=True))
    assert_allclose(draws.parts[0].residuals, expected, rtol=1e-9)


def test_residuals_are_drawn_of_both_outputs_at_once_and_missing_ones_from_the_others():
    draws, _ = pair_draws(missing=(3, 4, 17), noise="diagonal")
    residuals = draws.parts[0].residuals
    known = residuals[0][np.isfinite(residuals[0])]
    replaced = 0
    for number in range(4):
        drawn = next(draws.of(number)[1])[0] - draws.parts[0].fitted[0]
        assert np.flatnonzero(np.isnan(drawn[0])).tolist() == [3, 4, 17]
        places = [int(np.argmin(np.abs(residuals[1] - value))) for value in drawn[1]]
        assert_allclose(residuals[1][places], drawn[1], atol=1e-12)
        for k in np.flatnonzero(np.isfinite(drawn[0])):
            own = residuals[0][places[k]]
            if np.isnan(own):
                replaced += 1
                assert np.abs(known - drawn[0][k]).min() < 1e-12
            else:
                assert drawn[0][k] == pytest.approx(own, abs=1e-12)
    assert replaced > 0
