"""What must be >= 0, over several parts: each stated counts, and counts once."""

import numpy as np
from declared_models import TWO_LAGS_OMEGA, Lag, measured
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem

LAG = [
    measured(Lag(), TWO_LAGS_OMEGA, {"K": 3.0, "T": T}, noise=0.05, seed=k)
    for k, T in enumerate((0.2, 0.4))
]


def part(k, *constraints, **options):
    """One of two problems of one name."""
    return gb.Problem(Lag(), LAG[k], constraints=constraints, name="flight", **options)


def test_constraints_of_parts_of_one_name_all_count():
    """Each holds its own time constant away from the truth."""
    both = part(0, lambda p: 0.1 - p.T) + part(1, lambda p: p.T - 0.8, rename={"T": "T2"})
    nlp = compile_problem(both)
    values = dict(zip(nlp.names, nlp.all_values(np.arange(1.0, 1 + len(nlp.free))), strict=True))
    missed = np.asarray(nlp.constraint(np.array([*values.values()]))).ravel()
    assert_allclose(missed, [0.1 - values["T"], values["T2"] - 0.8])
    fit = gb.fit(both, starts=[{}], progress=False)
    assert_allclose([fit.estimate["T"], fit.estimate["T2"]], [0.1, 0.8], rtol=1e-6)


def test_a_constraint_that_parts_of_one_name_share_counts_once():
    both = part(0, lambda p: p.K - 2 * p.T) + part(1, lambda p: p.K - 2 * p.T)
    assert compile_problem(both).limits == ("constraints[0] of 'flight'",)


def test_a_constraint_that_parts_of_two_names_share_counts_once():
    runs = [part(k, lambda p: p.K - 2 * p.T).with_(name=f"run {k}") for k in range(2)]
    assert compile_problem(runs[0] + runs[1]).limits == ("constraints[0] of 'run 0'",)


def test_bounds_of_what_is_tied_alike_count_once():
    options = {"tied": {"T": lambda p: p.K / 10}, "bounds": {"T": (0.1, 0.5)}}
    limits = compile_problem(part(0, **options) + part(1, **options)).limits
    assert limits == ("the lower bound 0.1 of the tied T", "the upper bound 0.5 of the tied T")
