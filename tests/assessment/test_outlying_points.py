"""Outliers among the points of a response are named, and clean data have none more often than stated."""

from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import Lag, measured
from scipy.signal import lfilter
from scipy.stats import chi2, f as fisher
from unfolded import unfolded

import greybox as gb
from greybox.assessment.checks.unequal_errors import unequal_errors
from greybox.assessment.largest_deviation import SIZE, deletion_ratios, largest_deviation
from greybox.data.files.numbers_in_text import number
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.response_part import ResponsePart
from greybox.problems import pitch_hover

TRUTH = {"K": 5.0, "T": 0.3}
OMEGA = np.geomspace(0.5, 20, 20)
CRITERIA = [
    gb.RelativeError(),
    gb.SquaredRelativeError(),
    gb.RelativeLikelihood(),
    gb.MagnitudePhase(),
]


def spoiled(noise=0.05, seed=3, columns=None, by=1.6):
    data = measured(Lag(), OMEGA, TRUTH, noise=noise, seed=seed, columns=columns, name="sines")
    factor = np.where(np.arange(20) == 7, by, 1.0)
    columns = {name: getattr(data, name) for name in columns or {}}
    return gb.FrequencyResponse(OMEGA, data.response * factor, "u", "y", name="sines", **columns)


@pytest.mark.parametrize("criterion", CRITERIA, ids=repr)
def test_an_outlier_is_named_with_the_answer_without_it(criterion):
    data = spoiled()
    fit = gb.fit(gb.Problem(Lag(), data, criterion), starts=3)
    (said,) = [text for text in fit.warnings if "It is an outlier, or" in text]
    assert said in unfolded(fit)
    part = fit.responses[0]
    off = abs(data.response[7] / part.response[7] - 1)
    place = f"the point at {OMEGA[7]:.4g} rad/s of 'sines' is {100 * off:.2g} % from the model"
    assert said.startswith(f"{place}: fewer than one in ")
    nlp = compile_problem(gb.Problem(Lag(), data, criterion))
    found = largest_deviation(nlp.parts[0], nlp.all_values(fit.minima[0].estimate), 2)
    assert (found.index, found.relative) == (7, pytest.approx(off))
    assert f"fewer than one in {number(1 / max(20 * found.probability, 1e-12), 2)} fits" in said


def test_given_variances_judge_the_points():
    exact = np.abs(gb.frequency_response(Lag(), TRUTH, OMEGA).response)
    columns = {"variance": 2 * (0.05 * exact) ** 2}
    fit = gb.fit(gb.Problem(Lag(), spoiled(columns=columns), gb.MaximumLikelihood()), starts=3)
    assert any("It is an outlier, or" in text for text in fit.warnings)
    # Of two degrees of freedom, a variance that happens to be small explains such a point.
    columns["dof"] = np.full(20, 2.0)
    fit = gb.fit(gb.Problem(Lag(), spoiled(columns=columns), gb.MaximumLikelihood()), starts=3)
    assert not any("It is an outlier, or" in text for text in fit.warnings)


def test_probabilities_are_those_of_the_fisher_test_of_a_mean_shift():
    """Leaving a point out and fitting again by linear least squares, near the estimate."""
    data = spoiled(by=1.2)
    problem = gb.Problem(Lag(), data, gb.SquaredRelativeError())
    nlp = compile_problem(problem)
    x = gb.fit(problem, starts=3).minima[0].estimate
    part = nlp.parts[0]
    model = part.response(nlp.all_values(x))
    residual = (data.response - model) / np.abs(model)
    slope = part.sensitivity(nlp.all_values(x)) / np.abs(model)[:, None]

    def squares(kept):
        rows = np.vstack([slope[kept].real, slope[kept].imag])
        z = np.concatenate([residual[kept].real, residual[kept].imag])
        return np.sum((z - rows @ np.linalg.lstsq(rows, z, rcond=None)[0]) ** 2)

    everything = squares(np.arange(20))
    rest = np.array([squares(np.arange(20) != k) for k in range(20)])
    expected = fisher.sf((everything - rest) / 2 / (rest / 36), 2, 36)
    found = largest_deviation(part, nlp.all_values(x), 2)
    assert found.index == np.argmin(expected)
    assert found.probability == pytest.approx(expected.min(), rel=1e-6)


def test_given_degrees_of_freedom_make_students_t_of_a_residual():
    """Where the residuals are no larger than stated they are judged as they stand: (1 + |z|² / f)^(-f/2) for 2/f."""
    exact = gb.frequency_response(Lag(), TRUTH, OMEGA).response
    residual = np.where(np.arange(20) == 7, 3.0, 0.3) * np.exp(1j * np.arange(20))
    variance, dof = np.linspace(0.01, 0.02, 20), np.linspace(8, 30, 20)
    data = gb.FrequencyResponse(
        OMEGA, exact + residual * np.sqrt(variance), "u", "y", variance=variance, dof=dof
    )
    nlp = compile_problem(gb.Problem(Lag(), data, gb.MaximumLikelihood()))
    found = largest_deviation(
        nlp.parts[0], nlp.all_values(np.array([TRUTH[name] for name in nlp.free])), 2
    )
    assert found.index == 7
    assert found.probability == pytest.approx(fisher.sf(9.0, 2, dof[7]))


@pytest.mark.parametrize(("points", "is_judged"), [(3, True), (2, False)])
def test_two_degrees_of_freedom_must_be_left_of_the_other_points(points, is_judged):
    data = measured(Lag(), OMEGA[:points], TRUTH, noise=0.1)
    nlp = compile_problem(gb.Problem(Lag(), data, gb.SquaredRelativeError()))
    values = nlp.all_values(np.array([TRUTH[name] for name in nlp.free]))
    assert (largest_deviation(nlp.parts[0], values, 2) is not None) == is_judged


@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.MaximumLikelihood()], ids=repr)
def test_clean_data_have_outliers_no_more_often_than_stated(criterion):
    """200 draws: a share of 5 % is known to 1.5 %. Deviations are the same at the truth as at the estimate."""
    exact = gb.frequency_response(Lag(), TRUTH, OMEGA).response
    variance = 2 * (0.05 * np.abs(exact)) ** 2
    problem = gb.Problem(Lag(), gb.FrequencyResponse(OMEGA, exact, variance=variance), criterion)
    nlp = compile_problem(problem)
    values = nlp.all_values(np.array([TRUTH[name] for name in nlp.free]))
    random = np.random.default_rng(11)
    probabilities = []
    for _ in range(200):
        noise = 0.05 * (random.normal(size=20) + 1j * random.normal(size=20))
        data = gb.FrequencyResponse(OMEGA, exact * (1 + noise), variance=variance)
        compiled = nlp.parts[0]
        part = ResponsePart(problem.with_(data=data), compiled.functions, nlp.data, is_open=True)
        probabilities.append(20 * largest_deviation(part, values, 2).probability)
    shares = [np.mean(np.array(probabilities) < level) for level in (SIZE, 0.05)]
    assert shares[0] < 0.03
    assert 0.015 < shares[1] < 0.09 or criterion == gb.MaximumLikelihood()
    assert shares[1] < 0.09


def test_the_point_of_the_pitch_table_is_named_and_called_no_outlier():
    """Of ten points one fit to clean data in four has such a deviation: every answer says which point is farthest."""
    fit = gb.fit(pitch_hover.problem(), starts=5)
    assert not fit.warnings
    assert not fit.notes
    part = fit.responses[0]
    off = np.abs(part.response / part.data.response - 1)
    assert part.data.omega[np.argmax(off)] == pytest.approx(4.0)
    assert f"largest {100 * off.max():.0f} % at 4 rad/s" in str(fit)


def test_few_fits_to_clean_data_name_an_outlier_or_note_anything():
    """Of 12 fits at 1 % more than one have one with a probability of 0.006."""
    said = [
        text
        for seed in range(12)
        for fit in [
            gb.fit(
                gb.Problem(Lag(), measured(Lag(), OMEGA, TRUTH, noise=0.05, seed=seed)),
                starts=[TRUTH],
                profiles=False,
            )
        ]
        for text in (*fit.warnings, *fit.notes)
        if "clean data" in text
    ]
    assert len(said) <= 1


def test_a_joint_fit_names_the_outlier_of_its_response():
    time = np.arange(0, 10, 0.05)
    signal = np.sign(np.sin(time**1.3))
    exact = gb.simulate(Lag(), TRUTH, gb.Record(time, {"u": signal}), inputs="held")["y"]
    noisy = exact + 0.3 * np.random.default_rng(1).normal(size=time.size)
    flight = gb.Record(time, {"u": signal, "y": noisy})
    problem = gb.Problem(Lag(), spoiled()) + gb.Problem(
        Lag(), flight, gb.OutputError(inputs="held")
    )
    fit = gb.fit(problem, starts=[TRUTH])
    assert any("It is an outlier, or" in text for text in fit.warnings)


def test_noise_free_data_and_few_points_have_none():
    for data in (measured(Lag(), OMEGA, TRUTH), measured(Lag(), OMEGA[:2], TRUTH, noise=0.1)):
        fit = gb.fit(gb.Problem(Lag(), data), starts=[TRUTH, TRUTH])
        assert not any("outlier" in text for text in fit.warnings)


def test_a_point_that_a_parameter_of_its_own_fits_is_not_judged():
    random = np.random.default_rng(2)
    residual = 0.1 * (random.normal(size=6) + 1j * random.normal(size=6))
    own = np.zeros((6, 2), complex)
    own[3] = 1, 1j
    ratio, left = deletion_ratios(residual, own, least=0.0)
    assert left == 12 - 2 - 2
    assert np.isnan(ratio).tolist() == [False, False, False, True, False, False]
    squares = np.abs(residual) ** 2
    for k in (0, 1, 2, 4, 5):  # nothing else is fitted: its own square over the mean of the others
        rest = squares.sum() - squares[3] - squares[k]
        assert ratio[k] == pytest.approx(squares[k] / 2 / (rest / 8))
    for least in (0.5, 1e-9):
        ratio, _ = deletion_ratios(residual, own, least=least)
        mean = max((squares.sum() - squares[3] - squares[0]) / 8, least)
        assert ratio[0] == pytest.approx(squares[0] / 2 / mean)


def test_variances_that_include_more_than_the_scatter_are_not_doubted():
    """As those of a thinned log; without degrees of freedom, they are somebody's statement."""
    exact = np.abs(gb.frequency_response(Lag(), TRUTH, OMEGA).response)
    warned = []
    for dof in ({"dof": np.full(20, 100.0)}, {}):
        columns = {"variance": (0.2 * exact) ** 2, **dof}
        data = measured(Lag(), OMEGA, TRUTH, noise=0.02, seed=1, columns=columns)
        fit = gb.fit(gb.Problem(Lag(), data, gb.MaximumLikelihood()), starts=3)
        warned.append([text for text in fit.warnings if "residuals of" in text])
    assert not warned[0]
    assert any("too large" in text for text in warned[1])


@pytest.mark.parametrize(("growth", "is_named"), [(30.0, True), (1.0, False)])
def test_errors_that_grow_with_frequency_are_named(growth, is_named):
    omega = np.geomspace(0.5, 20, 30)
    data = measured(Lag(), omega, TRUTH, noise=0.0)
    random = np.random.default_rng(2)
    errors = 0.02 * random.normal(size=(30, 2)) @ [1, 1j] * np.geomspace(1, growth, 30)
    data = gb.FrequencyResponse(omega, data.response * (1 + errors), "u", "y")
    fit = gb.fit(gb.Problem(Lag(), data, gb.SquaredRelativeError()), starts=3)
    assert any("changes with frequency" in text for text in fit.warnings) == is_named


def test_errors_that_are_larger_in_the_middle_of_few_points_are_named():
    """Twelve points, ten times the errors in three: ranks see it in a fiftieth of such fits."""
    omega = np.geomspace(0.5, 20, 12)
    exact = measured(Lag(), omega, TRUTH, noise=0.0).response
    sizes = np.where(abs(np.arange(12) - 5) < 2, 0.1, 0.01)
    named = []
    for seed in range(10):
        errors = np.random.default_rng(seed).normal(size=(12, 2)) @ [1, 1j]
        data = gb.FrequencyResponse(omega, exact * (1 + sizes * errors), "u", "y")
        fit = gb.fit(gb.Problem(Lag(), data), starts=1)
        named += ["medium frequencies" in text for text in fit.warnings]
    assert sum(named) >= 5


class SevenParameters(gb.TransferFunction):
    """A lead, two lags, an oscillation and a delay."""

    K = gb.Parameter(2.0, bounds=(0.01, 50))
    T = gb.Parameter(0.4, bounds=(0.01, 5))
    w = gb.Parameter(3.0, bounds=(0.5, 20))
    z = gb.Parameter(0.3, bounds=(0.02, 2))
    L = gb.Parameter(0.2, bounds=(0.001, 3))
    tau = gb.Parameter(0.05, bounds=(0, 0.5))
    a = gb.Parameter(0.1, bounds=(0.001, 2))

    def response(self, s, p):
        lags = (s + p.a) * (p.T * s + 1) * (s**2 / p.w**2 + 2 * p.z * s / p.w + 1)
        return p.K * (p.L * s + 1) / lags * gb.exp(-s * p.tau)


def test_what_seven_parameters_leave_of_eight_points_is_not_called_unequal():
    """They fit some points exactly: 4 of these 10 right models were named."""
    omega = np.geomspace(0.1, 15, 8)
    model, truth = SevenParameters(), {"K": 2, "T": 0.4, "w": 3, "z": 0.3, "L": 0.2}
    truth |= {"tau": 0.05, "a": 0.1}
    exact = gb.frequency_response(model, truth, omega).response
    for seed in range(26, 36):
        errors = np.random.default_rng(seed).normal(size=(8, 2)) @ [0.02, 0.02j]
        data = gb.FrequencyResponse(omega, exact * (1 + errors), "u", "y")
        fit = gb.fit(gb.Problem(model, data), starts=[truth], profiles=False, progress=False)
        assert not any("changes with frequency" in text for text in fit.warnings)


@pytest.mark.parametrize(
    ("first", "last", "cure"),
    [(0.1, 1.0, ""), (0.2, 4.0, "larger variances at high"), (4.0, 0.2, "larger variances at low")],
)
def test_given_variances_are_doubted_only_where_they_are_too_small(first, last, cure):
    """Too large ones, such as those of a spectrum that allow for leakage, do no harm."""
    omega = np.geomspace(0.5, 20, 30)
    exact = measured(Lag(), omega, TRUTH, noise=0.0).response
    errors = np.random.default_rng(4).normal(size=(30, 2)) @ [1, 1j] / np.sqrt(2)
    measurement = exact * (1 + 0.03 * np.geomspace(first, last, 30) * errors)
    columns = {"variance": (0.03 * np.abs(exact)) ** 2, "dof": np.full(30, 40.0)}
    data = gb.FrequencyResponse(omega, measurement, "u", "y", **columns)
    fit = gb.fit(gb.Problem(Lag(), data, gb.MaximumLikelihood()), starts=3)
    messages = [text for text in fit.warnings if "changes with frequency" in text]
    assert cure in messages[0] if cure else not messages


def test_unequal_errors_of_a_response_are_judged_by_the_number_of_responses():
    """Errors that grow by chance are named in one of a hundred responses alone, not among thirty."""
    exact = gb.frequency_response(Lag(), TRUTH, OMEGA).response
    noise = np.random.default_rng(0).standard_normal((400, 20, 2)) @ [1, 1j]
    # Breusch and Pagan (1979): what a parabola explains of the squares of the errors.
    squares = np.abs(noise) ** 2 / np.mean(np.abs(noise) ** 2, axis=1, keepdims=True)
    parabolas = np.polynomial.legendre.legvander(np.linspace(-1, 1, 20), 2)
    explained = parabolas @ np.linalg.lstsq(parabolas, squares.T)[0] - 1
    p_values = chi2.sf(np.sum(explained**2, axis=0), 2)
    by_chance, white = np.argmin(np.abs(p_values - 2e-3)), np.argsort(-p_values)[:29]

    def named(*rows):
        parts = [
            gb.Problem(Lag(), gb.FrequencyResponse(OMEGA, exact * (1 + 0.05 * e), name=f"n{k}"))
            for k, e in ((k, noise[k]) for k in rows)
        ]
        nlp = compile_problem(sum(parts[1:], parts[0]))
        x = np.array([TRUTH[name] for name in nlp.free])
        evidence = SimpleNamespace(nlp=nlp, x=x, has_errors=True)
        return any("changes with frequency" in f.text for f in unequal_errors(evidence))

    assert 0.01 / 30 < p_values[by_chance] < 0.01
    assert named(by_chance)
    assert not named(by_chance, *white)


@pytest.mark.parametrize(
    ("share", "slow", "is_named"), [(1, 0, True), (0, 0, False), (0, 0.9, False)]
)
def test_errors_in_proportion_to_an_output_of_a_record_are_named(share, slow, is_named):
    """Slow errors of one size are as often large for long where a slow output is large.

    Of errors in proportion to it, 37 of 40 draws are named; the others look like a missing term.
    """
    random = np.random.default_rng(1)
    u = np.repeat(random.choice([0.1, 1.0], 12), 25)
    held = {"u": np.inf}
    record = gb.Record(0.05 * np.arange(300), {"u": u}, name="steps", hold=held)
    truth = gb.simulate(Lag(), {"K": 2.0, "T": 0.4}, record)["y"]
    errors = lfilter([1], [1, -slow], random.normal(size=300))
    y = truth + 0.05 * errors * np.where(share, truth, 1.0)
    problem = gb.Problem(Lag(), record.with_signals(y=y))
    fit = gb.fit(problem, starts=1, progress=False)
    assert any("follows that of y" in text for text in fit.warnings) == is_named
