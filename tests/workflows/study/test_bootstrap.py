"""The bootstrap against theory, single fits of the same data, and its own promises."""

import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from benchmark_module import benchmark
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import lfilter
from scipy.stats import norm, t as student

import greybox as gb
from greybox.assessment.result import Quantity
from greybox.cli.main import main
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.covariance.covariance import accuracy_at
from greybox.problems import pitch_hover, yaw_hover
from greybox.workflows.study.bootstrap import Bootstrap, interval_text, replicate_warnings, tail
from greybox.workflows.study.response_replicates import response_draws

pytestmark = pytest.mark.usefixtures("unjudged_file")

OMEGA = np.geomspace(0.5, 20, 8)
SIGMA = 0.05


class Gain(gb.TransferFunction):
    """A constant, of which the theory is short."""

    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0.1, 10))

    def response(self, s, p):
        return p.K + 0 * s


class Ramp(gb.StateSpace):
    """A constant in time."""

    states, inputs, outputs = (), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.K * u.u,)


@pytest.fixture(scope="module")
def pitch():
    return gb.fit(pitch_hover.problem(), starts=8, progress=False)


@pytest.fixture(scope="module")
def lag():
    data = measured(Lag(), OMEGA, {"K": 2.0, "T": 0.3}, noise=SIGMA, seed=1)
    return gb.fit(gb.Problem(Lag(), data, gb.SquaredRelativeError()), starts=8, progress=False)


def test_the_spread_of_a_mean_is_that_of_theory():
    # Of n points with errors σ in each component, the real parts tell of the gain: σ / √n.
    n, sigma = 80, 0.005
    data = measured(Gain(), np.geomspace(1, 10, n), {"K": 1.0}, noise=sigma, seed=0)
    fit = gb.fit(gb.Problem(Gain(), data, gb.SquaredRelativeError()), starts=6, progress=False)
    found = gb.bootstrap(fit, 400, progress=False)
    assert_allclose(found.standard_error["K"], sigma / np.sqrt(n), rtol=0.15)
    low, high = found.interval()["K"]
    assert_allclose((high - low) / 2, 1.98 * sigma / np.sqrt(n), rtol=0.2)


@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.MagnitudePhase()])
def test_a_replicate_is_the_fit_to_its_data(criterion):
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA[::3], TWO_LAGS, noise=0.03, seed=3)
    problem = gb.Problem(LagLagDelay(), data, criterion)
    fit = gb.fit(problem, starts=10, progress=False)
    found = gb.bootstrap(fit, 20, progress=False)
    nlp = compile_problem(problem)
    x = np.array([fit.estimate[name] for name in nlp.free])
    draws = response_draws(accuracy_at(nlp, x), 0)
    (response,) = draws.of(7)[1]
    drawn = replace(data, response=response)
    again = gb.fit(problem.with_(data=drawn), starts=[fit.estimate], progress=False)
    assert_allclose(
        [found[name][7] for name in nlp.free],
        [again.estimate[name] for name in nlp.free],
        rtol=2e-3,
    )


def test_replicates_follow_from_the_seed_alone(lag):
    alone = gb.bootstrap(lag, replicates=200, seed=4, progress=False)
    with ThreadPoolExecutor(2) as two:
        assert_array_equal(
            gb.bootstrap(lag, replicates=200, seed=4, executor=two, progress=False).values,
            alone.values,
        )
    assert_array_equal(
        gb.bootstrap(lag, replicates=140, seed=4, progress=False).values[:128], alone.values[:128]
    )
    assert not np.array_equal(
        gb.bootstrap(lag, replicates=2, seed=5, progress=False).values, alone.values[:2]
    )


def test_what_was_interrupted_goes_on(lag, tmp_path):
    whole = gb.bootstrap(lag, replicates=200, progress=False)

    def stop(done, count):
        if done == 150:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        gb.bootstrap(lag, replicates=200, folder=tmp_path, progress=stop)
    again = gb.bootstrap(lag, replicates=200, folder=tmp_path, progress=False)
    assert_array_equal(again.values, whole.values)
    assert again.interval() == whole.interval()
    with pytest.raises(ValueError, match="belong to another problem"):
        gb.bootstrap(lag, replicates=200, seed=1, folder=tmp_path, progress=False)


def test_replicates_survive_ctrl_c_without_a_folder(lag, press_ctrl_c):
    def stop(done, count):
        if done == 100:
            press_ctrl_c()

    with pytest.raises(KeyboardInterrupt, match=r"sys\.last_value\.samples") as stopped:
        gb.bootstrap(lag, replicates=2000, progress=stop)
    samples = stopped.value.samples
    assert 100 <= len(samples.values) < 1000
    assert f"after {len(samples.values)} replicates" in str(stopped.value)
    whole = gb.bootstrap(lag, replicates=100, progress=False)
    assert_array_equal(samples.values[:100], whole.values)
    assert_array_equal(samples.columns["T"], samples["T"])


def test_a_parameter_that_the_data_leave_open_has_no_upper_end():
    fit = gb.fit(yaw_hover.problem(), starts=4, profiles=False, progress=False)
    found = gb.bootstrap(fit, 200, progress=False)
    low, high = found.interval()["a2"]
    assert low > 50
    assert high == np.inf
    assert "above" in str(found)


def test_errors_of_constants_from_an_earlier_fit_are_drawn(lag):
    data = measured(Lag(), OMEGA, {"K": 2.0, "T": 0.3}, noise=0.001, seed=2)
    problem = gb.Problem(Lag(), data, gb.SquaredRelativeError(), fixed={"T": lag})
    fit = gb.fit(problem, starts=6, progress=False)
    with pytest.raises(ValueError, match="T from an earlier fit"):
        gb.bootstrap(fit, progress=False)
    found = gb.bootstrap(fit, replicates=300, problem=problem, progress=False)
    assert "T" not in found.names  # what is fixed has no replicates
    assert_allclose(found.standard_error["K"], fit.standard_error["K"], rtol=0.2)
    assert_allclose(found.standard_error["bandwidth"], lag.standard_error["bandwidth"], rtol=0.2)
    low, high = found.interval()["bandwidth"]
    assert high - low == pytest.approx(4 * lag.standard_error["bandwidth"], rel=0.25)


def test_errors_that_are_correlated_in_time_are_drawn_so():
    # Of a mean of n errors of an AR(1) the standard error is larger by √((1 + φ) / (1 - φ)) than of
    # white ones.
    n, fade = 2000, 0.7
    errors = lfilter([1], [1, -fade], np.random.default_rng(1).normal(size=n + 200))[200:]
    record = gb.Record(np.arange(n) / 10, {"u": np.ones(n), "y": 2.0 + 0.1 * errors})
    fit = gb.fit(gb.Problem(Ramp(), record), starts=[{}], progress=False)
    blocks = gb.bootstrap(fit, replicates=40, progress=False)
    white_error = 0.1 * np.std(errors) / np.sqrt(n)
    assert_allclose(
        blocks.standard_error["K"], white_error * np.sqrt((1 + fade) / (1 - fade)), rtol=0.3
    )
    assert blocks.about == "residuals drawn with their correlation in time"


def test_intervals_hold_the_truth_as_often_as_they_say():
    coverage = benchmark("bootstrap_coverage")
    make, truth = coverage.response_case(*coverage.RESPONSES[0][1:])
    counts, failed = coverage.held(make, truth, 8, 200)
    # Of 16 intervals of nominally 95 % at least 12 hold (99.9 % of the time).
    assert sum(counts["percentile"].values()) >= 12
    assert failed == 0


def test_what_cannot_be_drawn_is_refused(lag):
    with pytest.raises(ValueError, match="replicates is 1: give"):
        gb.bootstrap(lag, replicates=1)
    exact = gb.fit(
        gb.Problem(Lag(), measured(Lag(), OMEGA, {"K": 2.0, "T": 0.3})), starts=8, progress=False
    )
    with pytest.raises(ValueError, match="fitted exactly"):
        gb.bootstrap(exact)


def test_the_command_prints_what_the_function_finds(pitch, tmp_path, capsys):
    gb.save(pitch, tmp_path / "pitch.h5")
    words = [
        "bootstrap",
        str(tmp_path / "pitch.h5"),
        "--replicates",
        "150",
        "--json",
    ]
    assert main(words) == 0
    answer = json.loads(capsys.readouterr().out)
    expected = gb.bootstrap(pitch, 150, progress=False)
    assert answer["quantities"]["a1"]["interval"] == list(expected.interval()["a1"])
    assert answer["failed"] == 0
    assert main([*words, "--level", "2"]) == 2


def test_many_failed_replicates_are_told_and_few_are_not():
    assert not [*replicate_warnings(("",) * 1000, math.inf)]
    assert not [*replicate_warnings(("",) * 999 + ("stagnated",), math.inf)]
    (said,) = replicate_warnings(("",) * 500 + ("stagnated",) * 500, math.inf)
    assert said.startswith("500 of 1000 replicates failed (500 stagnated)")


def test_no_number_of_replicates_reaches_the_tails_of_one_degree_of_freedom():
    (text,) = replicate_warnings(("",) * 100, 1.26)
    assert "make" not in text
    assert "profile" in text


@pytest.fixture(scope="module")
def replicates():
    """Two quantities of 40 replicates, two of which failed; the first is held by its bounds, 0 and 10."""
    random = np.random.default_rng(0)
    values = np.column_stack(
        [np.clip(random.normal(2.0, 2.0, 40), 1e-9, 10 * (1 - 2e-5)), random.normal(size=40)]
    )
    values[[3, 7]] = np.nan
    first = Quantity("a", 1.8, 0.5, "free", "s", bounds=(1e-9, 10.0), dof=5.0)
    return Bootstrap(
        "made",
        about="residuals drawn",
        seed=3,
        quantities=(first, Quantity("b", 0.1, np.nan, "derived")),
        values=values,
        statuses=tuple("stagnated" if k in (3, 7) else "" for k in range(40)),
        seconds=1.25,
    )


def with_first(replicates, **changes):
    """Return replicates whose first quantity is another one."""
    first, *others = replicates.quantities
    return replace(replicates, quantities=(replace(first, **changes), *others))


def test_errors_and_biases_are_those_of_the_replicates_that_did_not_fail(replicates):
    done = np.delete(replicates.values, [3, 7], axis=0)
    assert replicates.failed == 2
    assert [*replicates.standard_error.values()] == pytest.approx(np.std(done, axis=0, ddof=1))
    assert [*replicates.bias.values()] == pytest.approx(done.mean(axis=0) - [1.8, 0.1])
    alone = replace(replicates, values=replicates.values[:1])
    assert np.isnan([*alone.standard_error.values()]).all()
    two = replace(replicates, values=replicates.values[:2])
    assert two.standard_error["b"] == pytest.approx(
        abs(np.diff(replicates.values[:2, 1])[0]) / np.sqrt(2)
    )


def test_an_interval_is_open_where_replicates_reach_the_bound(replicates):
    done = np.delete(replicates.values, [3, 7], axis=0)
    normal = with_first(replicates, dof=np.inf)
    assert normal.interval(0.5)["a"] == pytest.approx(np.quantile(done[:, 0], [0.25, 0.75]))
    wide = replicates.interval(0.95)
    assert wide["a"][0] == -math.inf
    assert wide["a"][1] < 10
    held = with_first(replicates, bounds=(1e-9, done[:, 0].max() * (1 + 0.5e-4)))
    assert held.interval(0.9999999)["a"] == (-math.inf, math.inf)
    apart = with_first(replicates, bounds=(1e-9, done[:, 0].max() * (1 + 3e-4)))
    assert apart.interval(0.9999999)["a"][1] == pytest.approx(done[:, 0].max())


@pytest.mark.parametrize(
    ("stretched", "said"), [(1.0, False), (2.4, False), (2.6, True), (1 / 2.6, True)]
)
def test_intervals_that_reach_farther_to_one_side_are_told(replicates, stretched, said):
    even = np.linspace(-1, 1, 1001)
    values = np.column_stack([np.where(even > 0, stretched * even, even), even])
    made = replace(
        replicates,
        values=values,
        quantities=tuple(Quantity(name, 0.0, 0.1, "derived") for name in "ab"),
    )
    assert bool(made.notes) is said
    assert ("note: the replicates of a reach" in str(made)) is said
    assert made.summary()["notes"] == [*made.notes]


def test_a_bootstrap_is_printed_with_its_numbers(replicates):
    text = str(replicates).splitlines()
    assert text[0] == "made: bootstrap, residuals drawn; 40 replicates, 2 failed"
    assert text[-1] == "  1.25 s; seed 3"
    (row,) = [line.split() for line in text if line.split()[:1] == ["a"]]
    error, bias = replicates.standard_error["a"], replicates.bias["a"]
    assert [float(x) for x in row[1:5]] == pytest.approx([1.8, error, 0.5, bias], rel=0.05)
    exact = with_first(replicates, standard_error=1 / 3)
    (row,) = [line.split() for line in str(exact).splitlines() if line.split()[:1] == ["a"]]
    assert [float(x) for x in row[2:5]] == [float(f"{error:.3g}"), 0.333, float(f"{bias:.2g}")]
    said = replicates.summary(0.8)
    assert (said["level"], said["statuses"], said["replicates"]) == (0.8, {"stagnated": 2}, 40)
    assert said["quantities"]["b"]["interval"] == pytest.approx(replicates.interval(0.8)["b"])
    assert said["quantities"]["b"]["fit_standard_error"] is None


@pytest.mark.parametrize(
    ("ends", "text"),
    [
        (None, "-"),
        ((None, None), "open"),
        ((None, 2.5), "below 2.5"),
        ((1.5, None), "above 1.5"),
        ((1, 2), "1 to 2"),
    ],
)
def test_an_interval_is_said(ends, text):
    assert interval_text(ends) == text


@pytest.mark.parametrize(("failed", "told"), [(50, False), (51, True)])
def test_a_twentieth_of_the_replicates_may_fail(failed, told):
    said = [*replicate_warnings(("stagnated",) * failed + ("",) * (1000 - failed), math.inf)]
    assert [text.startswith(f"{failed} of 1000 replicates failed (") for text in said] == [
        True
    ] * told


@pytest.mark.parametrize(
    ("count", "dof", "make"), [(161, math.inf, None), (159, math.inf, 200), (300, 3.0, 5500)]
)
def test_four_replicates_lie_beyond_each_end(count, dof, make):
    """Of 2.5 % of them, or of what normal replicates leave beyond Student's t of the degrees of freedom."""
    said = [text for text in replicate_warnings(("",) * count, dof) if "beyond each end" in text]
    assert [text.endswith(f"make {make} instead of {count}.") for text in said] == [True] * (
        make is not None
    )
    if make:
        share = norm.sf(student.ppf(0.975, dof))
        assert make - 100 < 4 / share <= make
        few = f"with {dof:.3g} degrees of freedom " if math.isfinite(dof) else ""
        assert said[0].startswith(
            f"{few}{100 * share:.2g} % of the replicates lie beyond each end of a 95 % interval"
        )


@pytest.mark.parametrize(
    ("change", "options", "error", "sentence"),
    [
        (
            {"converged": False, "status": "stagnated"},
            {},
            ValueError,
            "has no estimate: stagnated",
        ),
        ({}, {"seed": -1}, ValueError, "seed is -1: give"),
        ({}, {"seed": 1.0}, ValueError, "seed is 1.0: give"),
        (
            {},
            {"replicates": True},
            ValueError,
            "replicates is True: give",
        ),
        ({}, {"replicates": 2.0}, ValueError, "replicates is 2.0: give"),
        ({}, {"executor": ThreadPoolExecutor}, TypeError, "give an instance such as"),
        ({"spectra": ("one",)}, {}, ValueError, "'made' has manoeuvres, which are not drawn yet"),
        (
            {"parts": (SimpleNamespace(is_prior=True),)},
            {},
            ValueError,
            "'made' has a prior, which is not drawn",
        ),
        (
            {"records": (SimpleNamespace(gains=()),), "responses": ("one",)},
            {},
            ValueError,
            "'made' has records and responses",
        ),
        (
            {"records": (SimpleNamespace(gains=(("v", "v"),)),)},
            {},
            ValueError,
            "'made' has residuals that correct its states",
        ),
    ],
)
def test_what_cannot_be_repeated_is_said(change, options, error, sentence):
    known = {
        "name": "made",
        "converged": True,
        "status": "converged",
        "records": (),
        "responses": (),
        "spectra": (),
    }
    fit = Mock(gb.Fit)
    fit.configure_mock(**known | {"parts": (SimpleNamespace(is_prior=False),)} | change)
    fit.require_estimate = partial(gb.Fit.require_estimate, fit)
    with pytest.raises(error, match=sentence):
        gb.bootstrap(fit, **options)


@pytest.mark.parametrize("level", [0, 1, 95])
def test_a_level_is_a_share(replicates, level):
    with pytest.raises(ValueError, match=f"level {level} must lie between 0 and 1"):
        replicates.interval(level)


def test_what_has_no_replicates_is_named(replicates):
    with pytest.raises(KeyError, match="'c' has no replicates; there are a, b"):
        replicates["c"]
    assert_array_equal(replicates["b"], np.delete(replicates.values[:, 1], [3, 7]))


def test_intervals_are_quantiles_as_far_out_as_those_of_students_t():
    """Normal replicates of deviation 1, as a bootstrap of a mean gives them."""
    values = norm.ppf((np.arange(100_000) + 0.5) / 100_000)[:, None]
    for dof in (5.0, np.inf):
        made = Bootstrap(
            "made",
            about="",
            seed=0,
            quantities=(Quantity("a", 0.0, 1.0, "free", dof=dof),),
            values=values,
            statuses=("",) * len(values),
        )
        assert_allclose(
            made.interval()["a"], np.array([-1, 1]) * student.ppf(0.975, dof), rtol=2e-3
        )
        assert tail(0.95, dof) == pytest.approx(norm.sf(student.ppf(0.975, dof)))


def test_what_is_no_fit_is_named():
    with pytest.raises(
        TypeError, match=r"^fit is 'lag\.h5': give what gb\.fit or gb\.load returns"
    ):
        gb.bootstrap("lag.h5")
