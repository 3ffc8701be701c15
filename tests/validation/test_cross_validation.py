"""Points of responses are predicted by the fit to the other frequencies, and the errors are compared."""

import numpy as np
import pytest
from declared_models import measured
from drag_flights import Drag, LinearDrag, fitted, flight
from scipy.stats import ttest_1samp

import greybox as gb
from greybox.validation.comparison import p_text
from greybox.validation.cross_validation import cross_validation, pair_verdict


def test_of_few_frequencies_only_the_sizes_are_given():
    omega = np.array([1.0, 2.0, 3.0])
    verdict = pair_verdict("a", np.full(3, 0.1), "b", np.full(3, 0.2), omega)
    assert verdict == "a and b predict left-out frequencies to 10 % and 20 % rms."


@pytest.mark.parametrize("swapped", [False, True])
def test_more_frequencies_are_tested_by_students_t_of_their_means(swapped):
    """Two points at every frequency, of which the mean counts once."""
    random = np.random.default_rng(0)
    omega = np.tile(np.arange(1.0, 9.0), 2)
    good, bad = 0.05 * random.uniform(0.5, 1, 16), 0.05 * random.uniform(1.2, 2, 16)
    bad[[0, 8]] = 0.01
    both = ("b", bad, "g", good) if swapped else ("g", good, "b", bad)
    verdict = pair_verdict(*both, omega)
    difference = (bad - good).reshape(2, 8).mean(axis=0)
    p = ttest_1samp(difference, 0).pvalue
    assert p < 0.05
    assert verdict.startswith("g predicts left-out frequencies better than b")
    assert f"{np.sum(difference > 0)} of 8 frequencies ({p_text(p)})" in verdict


def test_no_difference_and_failed_fits_are_reported():
    random = np.random.default_rng(1)
    omega = np.arange(1.0, 6.0)
    one, other = random.uniform(0.1, 0.2, (2, 5))
    p = ttest_1samp(other - one, 0).pvalue
    assert p > 0.05
    verdict = pair_verdict("a", one, "b", other, omega)
    assert verdict.startswith("It cannot be told which of a and b")
    assert p_text(p) in verdict
    failed = pair_verdict("a", one, "c", np.full(5, np.nan), omega)
    assert failed == "c could not be fitted without some of the points."


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
    """Held against linear algebra."""
    fit, problem = shared
    data = [part.response for part in problem.parts]
    errors = []
    for fold in range(3):
        out = np.arange(6) % 3 == fold
        K, *c = least_squares([rows_of(d.where(~out), k, 3) for k, d in enumerate(data)])
        for d, gain in zip(data, c, strict=True):
            errors += [*np.abs((K / (1j * OMEGA + 1) + gain) / d.response - 1)[out]]
    rows, _ = cross_validation([fit, fit], ("a", "b"), 3)
    values = {row.measure: row.values for row in rows}
    assert values["sum of relative errors"] == pytest.approx([np.sum(errors)] * 2, rel=1e-5)
    rms = 100 * np.sqrt(np.mean(np.square(errors)))
    assert values["relative error (rms)"] == pytest.approx([rms] * 2, rel=1e-5)


@pytest.mark.parametrize("folds", [1, 7, 2.0, True, "axes"])
def test_folds_are_two_to_the_number_of_frequencies(shared, folds):
    with pytest.raises(ValueError, match="give a number from 2 to 6"):
        cross_validation([shared[0]], ("a",), folds)


def test_what_cannot_be_left_out_is_refused(shared):
    _, problem = shared
    few = gb.FrequencyResponse(
        OMEGA[:1], problem.parts[1].response.response[:1], input="u", output="y"
    )
    lonely = problem.parts[0] + problem.parts[1].with_(data=few, fixed={"c": 1.0}, rename={})
    fit = gb.fit(lonely, [{}], progress=False, profiles=False)
    with pytest.raises(ValueError, match="leaves no point of a response"):
        cross_validation([fit], ("a",), 3)
    record = flight({"a5": 0.2, "C_x": 0.05}, 8, duration=6.0)
    with pytest.raises(ValueError, match="frequency responses alone"):
        gb.compare(fitted(Drag(), record), fitted(LinearDrag(), record), folds=3)


class Softening(gb.StateSpace):
    """A lag whose output is bent, so that its response depends on the amplitude."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    K = gb.Parameter(2.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return (p.K * u.u - x.x,)

    def output(self, x, u, p):
        return (x.x - 0.1 * x.x**3,)


def test_amplitudes_of_single_frequencies_follow_the_points_that_stay():
    """Without noise every point is predicted exactly, by its own amplitude alone."""
    sine = gb.modeling.Sine("u", np.linspace(0.1, 1.0, 6))
    data = gb.modeling.harmonic_response(Softening(), {"K": 2.0}, OMEGA, amplitude=sine)
    fit = gb.fit(gb.Problem(Softening(), data, amplitude=sine), [{"K": 1.9}], progress=False)
    rows, _ = cross_validation([fit], ("a",), 3)
    assert rows[0].values[0] < 1e-4
