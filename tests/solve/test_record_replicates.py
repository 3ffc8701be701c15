"""Errors that replicates of a record draw, against those of a mean."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.solve.record_replicates import PIECES, record_draws

VALUES = 2 + 0.1 * np.random.default_rng(1).normal(size=12)


class Ramp(gb.StateSpace):
    """A constant in time."""

    states, inputs, outputs = (), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.K * u.u,)


def draws_of(drawn, values=VALUES, block=None):
    record = gb.Record(np.arange(len(values)) / 10, {"u": np.ones(len(values)), "y": values})
    nlp = compile_problem(gb.Problem(Ramp(), record))
    (part,) = nlp.parts
    z = nlp.scaling.to_solver(np.array([np.nanmean(values)]))
    return record_draws(nlp, (part.initial_trajectory(z),), drawn, 0, block)


def test_drawn_errors_have_the_variance_with_n_less_one_degrees_of_freedom():
    draws = draws_of("parametric")
    assert_allclose(draws.roots[0], [[np.std(VALUES, ddof=1)]])
    (one,) = draws.stretches[0]
    assert_allclose(one.residuals.std(), np.std(VALUES, ddof=1))
    assert_allclose(one.fitted, VALUES.mean())


def test_missing_samples_stay_missing_and_do_not_count():
    values = np.where(np.arange(12) % 3 == 1, np.nan, VALUES)
    draws = draws_of("residuals", values, block=2)
    (one,) = draws.stretches[0]
    assert_allclose(np.nanstd(one.residuals), np.nanstd(values, ddof=1))
    for number in range(5):
        ((drawn,),) = draws.outputs(number)
        assert np.isnan(drawn[0]).tolist() == np.isnan(values).tolist()


def test_every_sample_is_left_out_once_where_pieces_cross_from_record_to_record_too():
    """Two samples a piece, of records of 13 and 27."""
    records = [gb.Record(np.arange(n) / 10, {"u": np.ones(n), "y": np.arange(n) % 3.0}) for n in (13, 27)]
    nlp = compile_problem(gb.several(Ramp(), records))
    trajectories = tuple(part.initial_trajectory(nlp.scaling.to_solver(np.array([2.0]))) for part in nlp.parts)
    draws = record_draws(nlp, trajectories, "residuals", 0, None)
    left_out = np.array([np.concatenate([np.isnan(v).ravel() for (v,) in draws.without(k)]) for k in range(PIECES)])
    assert left_out.shape == (20, 40)
    assert left_out.sum(axis=0).tolist() == [1] * 40
    assert left_out.sum(axis=1).tolist() == [2] * 20


def test_a_block_is_no_longer_than_the_record():
    with pytest.raises(ValueError, match="block is 13: give a number of samples from 1 to 12"):
        draws_of("residuals", block=13)
