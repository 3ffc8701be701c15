"""Parameter vectors of one response, and the constraints that choose one of them."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from numpy.testing import assert_allclose

import greybox as gb
from greybox.estimate.equivalent_minima import relation, said

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=6)
OMEGA = np.geomspace(0.5, 50, 20)


class Roots(gb.TransferFunction):
    """Two squares with a lag: the signs of both roots are free."""

    a = gb.Parameter(1.5, bounds=(-5, 5))
    b = gb.Parameter(0.6, bounds=(-5, 5))

    def response(self, s, p):
        return p.a**2 / (p.b**2 * s + 1)


class Modes(gb.TransferFunction):
    """Two lags in parallel, each with its gain."""

    k1 = gb.Parameter(2.0, bounds=(0.1, 10))
    T1 = gb.Parameter(1.0, bounds=(0.01, 10), unit="s")
    k2 = gb.Parameter(0.5, bounds=(0.1, 10))
    T2 = gb.Parameter(0.1, bounds=(0.01, 10), unit="s")

    def response(self, s, p):
        return p.k1 / (p.T1 * s + 1) + p.k2 / (p.T2 * s + 1)


def noisy(model):
    exact = gb.frequency_response(model, {}, OMEGA).response
    random = np.random.default_rng(1)
    return gb.FrequencyResponse(
        OMEGA, exact * (1 + 0.01 * random.normal(size=20) + 0.01j * random.normal(size=20))
    )


def test_lags_that_swap_are_shown_with_the_order_that_keeps_one(tmp_path):
    fit = gb.fit(
        gb.Problem(LagLagDelay(), DATA), starts=[{}], progress=False
    )  # one run cannot have found both
    names = list(fit.free)
    first, second = fit.equivalents
    i, j = names.index("T1"), names.index("T2")
    assert_allclose(second[[i, j]], first[[j, i]])
    (text,) = [warning for warning in fit.warnings if "same response" in warning]
    high, low = ("T1", "T2") if fit.estimate["T1"] > fit.estimate["T2"] else ("T2", "T1")
    assert "T1 and T2 change places" in text
    assert f"constraints=[lambda p: p.{high} - p.{low}]" in text
    ordered = gb.fit(
        gb.Problem(LagLagDelay(), DATA, constraints=[lambda p: p[high] - p[low]]),
        starts=[{}],
        progress=False,
    )
    assert len(ordered.equivalents) == 1
    assert not [warning for warning in ordered.warnings if "same response" in warning]
    gb.save(fit, tmp_path / "fit.h5")
    assert_allclose(gb.load(tmp_path / "fit.h5").equivalents, fit.equivalents)


def test_signs_are_named_each_and_a_constraint_for_each():
    fit = gb.fit(gb.Problem(Roots(), noisy(Roots())), starts=[{}], progress=False)
    assert {tuple(np.sign(vector)) for vector in fit.equivalents} == {
        (1, 1),
        (1, -1),
        (-1, 1),
        (-1, -1),
    }
    (text,) = [warning for warning in fit.warnings if "same response" in warning]
    assert "a changes its sign" in text
    kept = gb.Problem(Roots(), noisy(Roots()), constraints=[lambda p: p.a, lambda p: p.b])
    assert len(gb.fit(kept, starts=[{}], progress=False).equivalents) == 1


def test_modes_that_change_places_with_their_gains_are_found_by_the_runs():
    starts = [{}, {"k1": 0.6, "T1": 0.12, "k2": 2.2, "T2": 0.9}]
    fit = gb.fit(gb.Problem(Modes(), noisy(Modes())), starts=starts, progress=False)
    assert len(fit.minima) == 1
    assert len(fit.equivalents) == 2
    (text,) = [warning for warning in fit.warnings if "same response" in warning]
    assert "k1 with k2 and T1 with T2 change places" in text
    assert_allclose(fit.equivalents[1], fit.equivalents[0][[2, 3, 0, 1]], rtol=1e-3)


@pytest.mark.parametrize(
    ("best", "other", "keeps"),
    [
        ([1.0, 2.0, 3.0], [2.0, 1.0, 3.0], "p.b - p.a"),
        ([-1.0, 2.0, 3.0], [1.0, -2.0, 3.0], "p.b"),
        ([-1.0, 2.0, 3.0], [1.0, 2.0, 3.0], "-p.a"),
        ([1.0, 2.0, 3.0], [1.0, 2.5, 3.7], ""),
    ],
)
def test_what_keeps_a_vector_holds_for_it_and_not_for_the_other(best, other, keeps):
    found = relation(("a", "b", "c"), np.array(best), np.array(other))[1]
    assert found == keeps
    if keeps:
        signs = [
            eval(keeps, {"p": gb.modeling.model.Names(dict(zip("abc", v, strict=True)), "")})
            for v in (best, other)
        ]
        assert signs[0] > 0 > signs[1]


def test_nothing_is_said_where_there_is_one():
    fit = gb.fit(
        gb.Problem(Modes(), noisy(Modes()), fixed={"T2": 0.1}), starts=[{}], progress=False
    )
    assert len(fit.equivalents) == 1


@pytest.mark.parametrize(
    ("best", "other", "words", "keeps"),
    [
        # The largest that is positive, then the largest.
        (
            [3.0, 2.0, 0.0, -5.0],
            [-3.0, -2.0, 0.0, 5.0],
            "a, b and d change their signs together",
            "p.a",
        ),
        (
            [-3.0, -2.0, 1.0, 0.0],
            [3.0, 2.0, 1.0, 0.0],
            "a and b change their signs together",
            "-p.a",
        ),
        # The pair that lies farthest apart beside its size.
        (
            [10.0, 11.0, 1.0, 2.0],
            [11.0, 10.0, 2.0, 1.0],
            "a with b and c with d change places",
            "p.d - p.c",
        ),
        (
            [2.0, 1.0, 11.0, 10.0],
            [1.0, 2.0, 10.0, 11.0],
            "a with b and c with d change places",
            "p.a - p.b",
        ),
        ([1.0, 2.0, 4.0, 3.0], [4.0, 2.0, 1.0, 3.0], "a and c change places", "p.c - p.a"),
        ([1.0, 2.0, 4.0, 3.0], [1.0, 2.0, 4.0, 3.01], "", ""),
        ([1.0, 2.0, 4.0, 3.0], [2.0, 1.0, 4.0, 9.0], "", ""),
    ],
)
def test_words_and_conditions_for_vectors_of_one_response(best, other, words, keeps):
    assert relation(("a", "b", "c", "d"), np.array(best), np.array(other)) == (words, keeps)


class Square(gb.TransferFunction):
    """The square of a gain."""

    a = gb.Parameter(1.5, bounds=(-5, 5))

    def response(self, s, p):
        return p.a**2 / (0.3 * s + 1)


@pytest.mark.parametrize(
    ("bounds", "count"), [((-5, 5), 2), ((-1, 5), 1), ((0.1, 5), 1), ((-5, -0.1), 1), ((-5, 1), 1)]
)
def test_what_lies_beyond_a_bound_is_no_equivalent(bounds, count):
    data = gb.FrequencyResponse(OMEGA, 2.25 / (0.3j * OMEGA + 1))
    start = 1.4 if bounds[1] > 1.5 else -1.4
    fit = gb.fit(
        gb.Problem(Square(), data, bounds={"a": bounds}), starts=[{"a": start}], progress=False
    )
    assert_allclose(
        fit.equivalents[:, 0],
        [np.copysign(1.5, start), -np.copysign(1.5, start)][:count],
        rtol=1e-4,
    )


def test_of_many_vectors_four_are_shown():
    vectors = np.array([[1.0, 5.0], [2.0, 5.1], [3.0, 5.0], [4.0, 5.0], [6.0, 5.0]])
    text, *table = said(("a", "b"), vectors).splitlines()
    assert text == (
        "at least 5 clearly different parameter vectors give this same response: add an ordering constraint or fix a "
        "parameter to choose one of them."
    )
    assert table[0].split() == ["given", "here", "also", "1", "also", "2", "also", "3"]
    assert table[-1].split() == ["a", "1", "2", "3", "4"]  # b is nearly the same in all
    assert len(table) == 3
