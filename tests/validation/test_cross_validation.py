"""What is said of the errors at points that were left out."""

from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import measured
from scipy.stats import ttest_1samp

import greybox as gb
from greybox.validation import cross_validation
from greybox.validation.comparison import p_text
from greybox.validation.cross_validation import FREQUENCIES, PARTS, _verdicts


def test_of_few_frequencies_sizes_are_told_of_every_pair_once():
    """Too few for a test of Student's t."""
    omega, labels = np.array([1.0, 2.0, 3.0]), ("a", "b", "c")
    said = _verdicts([np.full(3, size) for size in (0.1, 0.2, 0.3)], labels, omega, FREQUENCIES)
    assert said == [
        "a and b predict left-out frequencies to 10 % and 20 % rms.",
        "a and c predict left-out frequencies to 10 % and 30 % rms.",
        "b and c predict left-out frequencies to 20 % and 30 % rms.",
    ]


@pytest.mark.parametrize("swapped", [False, True])
def test_more_frequencies_are_tested_by_students_t_of_their_means(swapped):
    """Two points at every frequency, of which the mean counts once."""
    random = np.random.default_rng(0)
    omega = np.tile(np.arange(1.0, 9.0), 2)
    good, bad = 0.05 * random.uniform(0.5, 1, 16), 0.05 * random.uniform(1.2, 2, 16)
    bad[[0, 8]] = 0.01
    errors, labels = ([bad, good], ("b", "g")) if swapped else ([good, bad], ("g", "b"))
    (said,) = _verdicts(errors, labels, omega, FREQUENCIES)
    difference = (bad - good).reshape(2, 8).mean(axis=0)
    p = ttest_1samp(difference, 0).pvalue
    assert p < 0.05
    sizes = [f"{100 * np.sqrt(np.mean(e**2)):.3g} %" for e in (good, bad)]
    assert said == (
        f"g predicts left-out frequencies better than b, to {sizes[0]} rms against {sizes[1]}, at "
        f"{np.sum(difference > 0)} of 8 frequencies ({p_text(p)})."
    )


def test_no_difference_and_failed_fits_are_told():
    random = np.random.default_rng(1)
    omega = np.arange(1.0, 6.0)
    one, other = random.uniform(0.1, 0.2, (2, 5))
    p = ttest_1samp(other - one, 0).pvalue
    assert p > 0.05
    sizes = [f"{100 * np.sqrt(np.mean(e**2)):.3g} %" for e in (one, other)]
    failed = np.full(5, np.nan)
    assert _verdicts([one, other, failed], ("a", "b", "c"), omega, PARTS) == [
        "It cannot be told which of a and b predicts responses that were left out better: "
        f"{sizes[0]} and {sizes[1]} rms ({p_text(p)}).",
        "c could not be fitted without some of the points.",
        "c could not be fitted without some of the points.",
    ]


# --- a gain that all responses share, beside one of each: linear in its parameters


class Gains(gb.TransferFunction):
    """K/(s + 1) + c."""

    K = gb.Parameter(2.0, bounds=(-100, 100))
    c = gb.Parameter(0.5, bounds=(-100, 100))

    def response(self, s, p):
        return p.K / (s + 1) + p.c


OMEGA = np.geomspace(0.2, 5, 6)


@pytest.fixture(scope="module")
def shared():
    """Three responses with a common K, each with a c of its own, by squares of relative errors."""
    parts = [
        gb.Problem(
            Gains(),
            measured(Gains(), OMEGA, {"K": 2.0, "c": c}, noise=0.1, seed=k),
            gb.SquaredRelativeError(),
            rename={"c": f"c{k}"},
        )
        for k, c in enumerate((0.5, 1.0, -0.6))
    ]
    problem = sum(parts)
    return gb.fit(problem, [{}], progress=False, profiles=False), problem


def rows_of(data, k, of):
    """Rows of K and the c of every response, over the size of what was measured, and the right-hand side."""
    columns = np.zeros((data.omega.size, 1 + of), dtype=complex)
    columns[:, 0], columns[:, 1 + k] = 1 / (1j * data.omega + 1), 1.0
    size = np.abs(data.response)
    return columns / size[:, None], data.response / size


def least_squares(blocks):
    A, b = np.vstack([A for A, _ in blocks]), np.concatenate([b for _, b in blocks])
    return np.linalg.lstsq(
        np.vstack([A.real, A.imag]), np.concatenate([b.real, b.imag]), rcond=None
    )[0]


def test_points_are_predicted_by_the_fit_to_the_other_folds(shared):
    fit, problem = shared
    data = [part.response for part in problem.parts]
    folds = cross_validation._folds(fit, 3)
    assert [[out.tolist() for out in fold] for fold in folds] == [
        [[k % 3 == j for k in range(6)]] * 3 for j in range(3)
    ]
    predicted, own = cross_validation._frequencies_left_out(fit, problem, folds)
    assert own == 0
    for fold in folds:
        kept = [
            rows_of(d.where(~out), k, 3) for k, (d, out) in enumerate(zip(data, fold, strict=True))
        ]
        found = least_squares(kept)
        for k, (values, out) in enumerate(zip(predicted, fold, strict=True)):
            expected = found[0] / (1j * OMEGA + 1) + found[1 + k]
            assert values[out] == pytest.approx(expected[out], rel=1e-5)


def test_a_response_is_predicted_by_the_others_and_what_is_its_own_by_itself(shared):
    fit, problem = shared
    data = [part.response for part in problem.parts]
    predicted, own = cross_validation._parts_left_out(fit, problem, "it")
    assert own == 3
    for k, values in enumerate(predicted):
        K = least_squares([rows_of(d, i, 3) for i, d in enumerate(data) if i != k])[0]
        A, b = rows_of(data[k], 0, 1)
        c = least_squares([(A[:, 1:], b - A[:, 0] * K)])[0]
        assert values == pytest.approx(K / (1j * OMEGA + 1) + c, rel=1e-5)


@pytest.mark.parametrize("folds", [1, 7, 2.0, True, "axes"])
def test_folds_are_two_to_the_number_of_frequencies(shared, folds):
    with pytest.raises(
        ValueError, match=r"folds is .*: give a number from 2 to 6, the number of frequencies"
    ):
        cross_validation._folds(shared[0], folds)
    assert len(cross_validation._folds(shared[0], 6)) == 6


def test_responses_that_cannot_be_left_out_are_told(shared):
    _, problem = shared
    alone = problem.parts[0]
    one = gb.fit(alone, [{}], progress=False, profiles=False)
    with pytest.raises(ValueError, match="it has one response, which cannot be left out"):
        cross_validation._parts_left_out(one, alone, "it")
    apart = alone + problem.parts[1].with_(rename={"c": "c1", "K": "K1"})
    with pytest.raises(ValueError, match="of it shares no free parameter with the other parts"):
        cross_validation._parts_left_out(
            gb.fit(apart, [{}], progress=False, profiles=False), apart, "it"
        )
    few = gb.FrequencyResponse(
        OMEGA[:1], problem.parts[1].response.response[:1], input="u", output="y"
    )
    lonely = alone + problem.parts[1].with_(data=few, fixed={"c": 1.0}, rename={})
    with pytest.raises(
        ValueError, match="folds is 3: one of them leaves no point of a response; give more folds"
    ):
        cross_validation._folds(gb.fit(lonely, [{}], progress=False, profiles=False), 3)


def test_amplitudes_of_single_frequencies_are_those_of_the_points_that_are_kept(shared):
    kept = np.array([True, False, True])
    sine = gb.modeling.Sine("u", np.array([1.0, 2.0, 3.0]))
    assert cross_validation._sine(SimpleNamespace(amplitude=sine), kept).amplitude.tolist() == [
        1.0,
        3.0,
    ]
    one = gb.modeling.Sine("u", 2.0)
    assert cross_validation._sine(SimpleNamespace(amplitude=one), kept) is one
    assert cross_validation._sine(SimpleNamespace(amplitude=None), kept) is None


def test_records_are_held_out_otherwise():
    with pytest.raises(
        ValueError, match="folds are for frequency responses alone: hold records out by records="
    ):
        cross_validation.cross_validation(
            [SimpleNamespace(responses=(), parts=("a record",))], ("a",), 3
        )
