"""What a fit leaves open goes to its end, and nothing else does."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured

import greybox as gb
from greybox.modeling.limit import Limit, at_limit
from greybox.models.yaw import YawAngle
from greybox.problems import pitch_hover, yaw_hover
from greybox.validation import reduction
from greybox.validation.reduction import Candidate, Reduction, Tried, _directions


@pytest.fixture(scope="module")
def yaw():
    return gb.reduce(gb.fit(yaw_hover.problem(), starts=8), starts=4)


def test_the_yaw_of_the_paper_has_three_parameters(yaw):
    """The limit by hand: (a3/a2)(s + a4)/(s + a4 + a1/a2) behind integrator, rotor and delay."""
    assert str(yaw).startswith(
        "yaw hover: 3 parameters instead of 4, cost 0.8083 against 0.8045: a2 → ∞"
    )
    assert yaw.test.p_value > 0.5
    assert yaw.comparison.supported == "the reduced one"
    data = yaw_hover.data()
    s = 1j * data.omega
    e = yaw.fit.estimate
    zero = s + e["a4"]
    by_hand = (
        e["a3_tilde_per_a2"]
        * zero
        / (zero + e["a1_tilde_per_a2"])
        / s
        / (0.048 * s + 1)
        * np.exp(-0.0042 * s)
    )
    np.testing.assert_allclose(yaw.fit.responses[0].response, by_hand, rtol=2e-8)
    assert np.sum(np.abs(by_hand / data.response - 1)) == pytest.approx(yaw.fit.cost, rel=1e-6)
    # The ratios are those that the full fit determines, with its errors.
    ratios = {c.formula: c for c in yaw.large.identifiability.combinations}
    for formula, name in (("a3_tilde/a2", "a3_tilde_per_a2"), ("a1_tilde/a2", "a1_tilde_per_a2")):
        assert e[name] == pytest.approx(ratios[formula].value, abs=ratios[formula].standard_error)
        assert yaw.fit.standard_error[name] == pytest.approx(
            ratios[formula].standard_error, rel=0.3
        )
    units = {q.name: q.unit for q in yaw.fit.quantities}
    assert units["a3_tilde_per_a2"] == "1/s"


def test_a_reduced_fit_is_saved_and_loaded(yaw, tmp_path):
    gb.save(yaw.fit, tmp_path / "yaw.h5")
    loaded = gb.load(tmp_path / "yaw.h5")
    assert loaded.estimate == yaw.fit.estimate
    omega = np.array([0.5, 5.0])
    np.testing.assert_array_equal(loaded.response(omega).response, yaw.fit.response(omega).response)


def test_a_lag_that_is_too_fast_to_be_seen_is_left_out_in_all_parts():
    omega = np.geomspace(0.1, 10, 15)
    truth = {"T1": 0.5, "T2": 0.0012, "tau": 0.0}
    parts = [
        gb.Problem(
            LagLagDelay(),
            measured(LagLagDelay(), omega, {"K": gain, **truth}, noise=0.05, seed=seed),
            fixed={"tau": 0.0},
            rename={"K": f"K_{seed}", "T2": "T_fast"},
        )
        for gain, seed in ((2.0, 1), (3.0, 2))
    ]
    fit = gb.fit(sum(parts), starts=[{"K_1": 2.0, "K_2": 3.0, "T1": 0.5, "T_fast": 0.0012}])
    found = gb.reduce(fit, starts=1)
    assert [str(candidate) for candidate in found.taken] == ["T_fast = 0"]
    assert set(found.fit.free) == {"K_1", "K_2", "T1"}
    alone = gb.fit(
        sum(gb.Problem(Lag(), p.response, rename={"K": p.rename["K"], "T": "T1"}) for p in parts),
        starts=[{"K_1": 2.0, "K_2": 3.0, "T1": 0.5}],
    )
    assert found.fit.cost == pytest.approx(alone.cost, rel=1e-6)


def test_what_is_determined_is_left_alone():
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02)
    fit = gb.fit(gb.Problem(LagLagDelay(), data), starts=4)
    found = gb.reduce(fit)
    assert found.fit is fit
    assert found.taken == ()
    assert "not reduced" in str(found)


def test_a_needed_parameter_with_a_large_error_stays():
    """Noise of 40 % leaves errors of both lags above the guideline, and the absence of either is rejected."""
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, {**TWO_LAGS, "tau": 0.0}, noise=0.4, seed=3)
    fit = gb.fit(gb.Problem(LagLagDelay(), data, fixed={"tau": 0.0}), starts=4)
    assert fit.identifiability.beyond
    found = gb.reduce(fit, starts=2)
    assert found.tried
    assert found.taken == ()
    assert "the data reject every limit" in str(found)


def test_directions_leave_products_as_they_are():
    products = [{"a": 2, "b": -1}, {"b": 1, "c": -1}]  # a²/b and b/c: b and c go as the square of a
    assert list(_directions(products)) == [{"a": 1, "b": 2, "c": 2}]
    assert list(_directions([{"a": 1, "b": 1}])) in ([{"a": 1, "b": -1}], [{"b": 1, "a": -1}])
    assert list(_directions([])) == []


def test_limits_by_powers_and_to_zero():
    """K/(T s + 1) with K and T to infinity together integrates; with K T kept and T to infinity it vanishes."""
    omega = np.array([0.5, 2.0])
    model = Limit(Lag(), "T", 2.0, "infinity", (("K", 1, 6.0),))
    assert list(model.parameters) == ["K_per_T"]
    assert model.derived == {}
    assert gb.frequency_response(model, {}, omega).response == pytest.approx(3.0 / (1j * omega))
    model = Limit(Lag(), "T", 2.0, "zero")
    assert gb.frequency_response(model, {"K": 4.0}, omega).response == pytest.approx(4.0)
    with pytest.raises(ValueError, match="Lag has no parameter 'T9'; it has K, T"):
        Limit(Lag(), "T9", 2.0, "zero")
    with pytest.raises(ValueError, match="end is 'sky': give 'infinity' or 'zero'"):
        Limit(Lag(), "T", 2.0, "sky")


def test_what_cannot_be_reduced_is_told(yaw):
    with pytest.raises(ValueError, match="has other unknowns than the fit"):
        gb.reduce(yaw.large, problem=pitch_hover.problem())
    tied = gb.fit(
        gb.Problem(YawAngle(), yaw_hover.data(), tied={"a4": lambda p: 0.01 * p.a2}), starts=2
    )
    with pytest.raises(ValueError, match="has ties"):
        gb.reduce(tied)
    known = gb.fit(gb.Problem(YawAngle(), yaw_hover.data(), prior={"a4": (5.6, 0.2)}), starts=2)
    with pytest.raises(ValueError, match="has a-priori knowledge, with which nothing is reduced"):
        gb.reduce(known)


# --- equations in time


class TwoGains(gb.StateSpace):
    """A lag whose gain is a product."""

    states, inputs, outputs = ("y",), ("u",), ("y",)
    K = gb.Parameter(2.0, bounds=(0.01, 100))
    M = gb.Parameter(1.5, bounds=(0.01, 100))
    a = gb.Parameter(1.0, bounds=(0.01, 50))

    def derivative(self, x, u, p):
        return (p.K * p.M * u.u - p.a * x.y,)

    def output(self, x, u, p):
        return (x.y,)


class FastLag(gb.StateSpace):
    """A lag behind a delay and a lag that is too fast to be seen."""

    states, inputs, outputs = ("y", "z"), ("u",), ("y",)
    delays = {"u": "tau"}
    a = gb.Parameter(1.0, bounds=(0.01, 50))
    w = gb.Parameter(500.0, bounds=(1, 1e5))
    tau = gb.Parameter(0.0, bounds=(0, 0.1), fixed=True)

    def derivative(self, x, u, p):
        return (x.z - p.a * x.y, p.w * (u.u - x.z))

    def output(self, x, u, p):
        return (x.y,)


def flown(model, values):
    time = np.arange(120) / 10
    u = np.sin(time) + np.sin(2.7 * time)
    y = gb.simulate(model, values, gb.Record(time, {"u": u}))["y"]
    return gb.Record(
        time, {"u": u, "y": y + 0.02 * np.random.default_rng(0).normal(size=time.size)}
    )


def test_a_product_of_gains_in_time_is_one_parameter(tmp_path):
    """Held against the fit of the structure written by hand."""
    values = {"K": 2.0, "M": 1.5, "a": 1.0}
    record, criterion = flown(TwoGains(), values), gb.OutputError(inputs="linear")
    large = gb.fit(gb.Problem(TwoGains(), record, criterion), starts=[values], progress=False)
    found = gb.reduce(large, starts=1)
    by_hand = gb.fit(
        gb.Problem(TwoGains(), record, criterion, fixed={"M": 1.0}),
        starts=[{"K": 3.0, "a": 1.0}],
        progress=False,
    )
    assert [str(one) for one in found.taken] in (["K → ∞, M·K kept"], ["K → 0, M·K kept"])
    assert found.fit.estimate["M_times_K"] == pytest.approx(by_hand.estimate["K"], rel=1e-5)
    assert found.fit.standard_error["M_times_K"] == pytest.approx(
        by_hand.standard_error["K"], rel=1e-3
    )
    assert found.fit.cost == pytest.approx(by_hand.cost, abs=1e-4)
    assert "for residuals that are correlated in time" in str(found.test)
    gb.save(found.fit, tmp_path / "gains.h5")
    loaded = gb.load(tmp_path / "gains.h5", models=[TwoGains])
    assert loaded.estimate == found.fit.estimate


def test_an_ode_is_reduced_by_its_responses_and_its_stiff_limit_in_time_is_told():
    values = {"a": 1.0, "w": 500.0}
    omega = np.geomspace(0.1, 10, 15)
    data = measured(FastLag(), omega, values, noise=0.03)
    found = gb.reduce(gb.fit(gb.Problem(FastLag(), data), starts=[values]), starts=1)
    assert [str(one) for one in found.taken] == ["w → ∞"]
    by_hand = 1 / (1j * omega + found.fit.estimate["a"])
    np.testing.assert_allclose(found.fit.responses[0].response, by_hand, rtol=2e-8)

    in_time = gb.Problem(FastLag(), flown(FastLag(), values), gb.OutputError(inputs="linear"))
    told = gb.reduce(gb.fit(in_time, starts=[values], progress=False), starts=1)
    assert "the equations are too stiff in time for w → ∞: write those of the limit" in str(told)
    assert next(one for one in told.tried if one.why_not).fit is None


def test_a_delay_goes_to_zero_alone():
    assert at_limit(FastLag(), "tau", 0.01, "zero").delays == {}
    assert at_limit(FastLag(), "w", 1.0, "infinity").delays == {"u": "tau"}
    with pytest.raises(
        ValueError, match="tau delays an input of FastLag: a delay can go to zero alone"
    ):
        at_limit(FastLag(), "tau", 0.01, "infinity")


class Braked(gb.StateSpace):
    """x' = -k x², of which the pole is -2 k x."""

    states, outputs = ("x",), ("x",)
    k = gb.Parameter(2.0)

    def derivative(self, x, u, p):
        return (-p.k * x.x**2 + u.u / p.k,)

    def output(self, x, u, p):
        return (x.x,)


def test_the_fastest_pole_is_that_about_the_first_initial_state():
    assert reduction._fastest(Braked(), {"k": 2.0}, {"x": np.array([3.0, 9.0])}) == pytest.approx(
        12.0
    )
    assert reduction._fastest(Braked(), {"k": 2.0}, {}) == 0.0
    assert reduction._fastest(FastLag(), {"a": 1.0, "w": 500.0, "tau": 0.0}, {}) == pytest.approx(
        500.0
    )
    assert reduction._fastest(Braked(), {"k": np.inf}, {"x": np.array([3.0])}) == np.inf


# --- parts at a limit


def fitted_values(**estimate):
    return SimpleNamespace(estimate=estimate)


def lag_problem(omega=(0.05, 10.0), **options):
    values = {"K_1": 6.0, "T_1": 2.0}
    s = 1j * np.asarray(omega)
    data = gb.FrequencyResponse(omega, 6.0 / (2.0 * s + 1), input="u", output="y")
    return gb.Problem(Lag(), data, rename={"K": "K_1", "T": "T_1"}, **options), fitted_values(
        **values
    )


def test_a_part_at_a_limit_has_the_names_outside():
    problem, fit = lag_problem(starts={"K": (1, 2)})
    both = reduction._part_at_limit(problem, Candidate({"T_1": 1, "K_1": 1}, "infinity"), fit)
    assert list(both.parameters) == ["K_1_per_T_1"]
    assert both.parameters["K_1_per_T_1"].start == 3.0
    alone = reduction._part_at_limit(problem, Candidate({"T_1": 1}, "zero"), fit)
    assert list(alone.parameters) == ["K_1"]
    assert alone.parameters["K_1"].starts == (1, 2)
    assert reduction._part_at_limit(problem, Candidate({"a": 1, "b": 1}, "zero"), fit) is problem
    assert reduction._part_at_limit(problem, Candidate({"a": 1, "K_1": 1}, "zero"), fit) is None
    same = gb.Problem(Lag(), problem.response)
    made = reduction._part_at_limit(
        same, Candidate({"T": 1, "K": 1}, "infinity"), fitted_values(K=6.0, T=2.0)
    )
    assert list(made.parameters) == ["K_per_T"]


def test_a_bias_of_a_sensor_has_no_limit():
    time = np.arange(20) / 10
    record = gb.Record(time, {"u": np.sin(time), "y": np.cos(time)})
    problem = gb.Problem(TwoGains(), record, gb.OutputError(biases=("y",)))
    (bias,) = set(problem.declared) - set(problem.model.parameters)
    known = fitted_values(K=2.0, M=1.5, a=1.0, **{bias: 0.1})
    assert reduction._part_at_limit(problem, Candidate({bias: 1}, "zero"), known) is None
    assert reduction._part_at_limit(problem, Candidate({"K": 1, bias: 1}, "zero"), known) is None
    assert reduction._part_at_limit(problem, Candidate({"K": 1}, "zero"), known) is not None


def has_limit(problem, powers, end, fit):
    return reduction._has_limit(
        reduction._part_at_limit(problem, Candidate(powers, end), fit), problem, fit
    )


def test_a_limit_is_told_from_none():
    """A part in ten million is left out at the value that stands for the end, and less further on."""
    slow, fit = lag_problem((0.05, 0.1))
    fast, _ = lag_problem((5.0, 10.0))
    assert has_limit(slow, {"T_1": 1, "K_1": 1}, "infinity", fit)
    assert has_limit(fast, {"T_1": 1}, "zero", fit)
    assert not has_limit(fast, {"K_1": 1}, "infinity", fit)  # without end
    assert not has_limit(fast, {"K_1": 1}, "zero", fit)  # nothing is left of the response
    assert not has_limit(fast, {"T_1": 1}, "infinity", fit)


class Grown(gb.TransferFunction):
    """Finite nowhere but at finite values."""

    a = gb.Parameter(1.0, bounds=(0, 100))
    K = gb.Parameter(1.0)

    def response(self, s, p):
        return p.K * gb.exp(p.a) / (s + 1)


def test_what_is_not_finite_is_no_limit():
    data = gb.FrequencyResponse([1.0, 2.0], [1.0, 0.5], input="u", output="y")
    fit = fitted_values(a=1.0, K=1.0)
    assert not has_limit(gb.Problem(Grown(), data), {"a": 1}, "infinity", fit)
    assert has_limit(gb.Problem(Grown(), data), {"a": 1}, "zero", fit)


# --- what is open, and how it is said


def test_open_are_those_without_a_small_error_and_those_at_a_bound():
    judged = SimpleNamespace(
        names=("well", "badly", "unknown", "nothing", "bound"),
        error=(0.01, 0.9, np.nan, 0.9, 0.01),
        at_bound=("bound",),
        combinations=[
            SimpleNamespace(names=("badly", "unknown"), powers=(1, 1), is_product=True),
            SimpleNamespace(names=("badly", "well"), powers=(1, 1), is_product=False),
        ],
    )
    estimate = {"well": 1.0, "badly": 1.0, "unknown": 1.0, "nothing": 0.0, "bound": 1.0}
    found = list(reduction._candidates(SimpleNamespace(identifiability=judged, estimate=estimate)))
    assert [(dict(c.powers), c.end) for c in found] == [
        ({"badly": 1, "unknown": -1}, "infinity"),
        ({"badly": 1, "unknown": -1}, "zero"),
        *[
            ({name: 1}, end)
            for name in ("badly", "unknown", "bound")
            for end in ("zero", "infinity")
        ],
    ]
    said = (
        "a → ∞, b/a² and c·a³ kept",
        "a → 0, b/a² and c·a³ kept",
        "a → ∞",
        "a = 0",
        "a → 0, b·a^4 kept",
    )
    powers = (
        {"a": 1, "b": 2, "c": -3},
        {"a": 1, "b": 2, "c": -3},
        {"a": 1},
        {"a": 1},
        {"a": 1, "b": -4},
    )
    ends = "infinity", "zero", "infinity", "zero", "zero"
    assert tuple(str(Candidate(p, end)) for p, end in zip(powers, ends, strict=True)) == said


def test_a_basis_of_what_leaves_products_alone_is_complete():
    """As many vectors as the rank leaves, orthogonal to all rows and independent of one another."""
    random = np.random.default_rng(0)
    for rows, width in ((1, 1), (1, 3), (2, 4), (3, 4), (4, 3), (3, 6)):
        matrix = random.integers(-2, 3, size=(rows, width))
        basis = np.array(reduction._null_space(matrix.tolist(), width), dtype=float).reshape(
            -1, width
        )
        assert len(basis) == np.linalg.matrix_rank(basis) == width - np.linalg.matrix_rank(matrix)
        np.testing.assert_allclose(basis @ matrix.T, np.zeros((len(basis), rows)), atol=1e-12)


@pytest.mark.parametrize(
    ("tried", "said"),
    [
        ([], r"not reduced; no parameter with an error above \d+ % has an end"),
        (["rejected"], r"not reduced; the data reject every limit at 5 %\."),
        (
            ["stiff"],
            r"not reduced; the equations are too stiff in time for w → ∞: write those of the limit\.",
        ),
        (
            ["rejected", "stiff"],
            r"the data reject every other limit at 5 %, and the equations are too stiff in time for w → ∞: write",
        ),
        (["failed"], r"the data reject every limit"),
    ],
)
def test_why_nothing_was_reduced_is_said(tried, said):
    kinds = {
        "rejected": Tried(
            Candidate({"a": 1}, "zero"), SimpleNamespace(cost=3.0), SimpleNamespace(p_value=0.01)
        ),
        "stiff": Tried(
            Candidate({"w": 1}, "infinity"), None, None, why_not=reduction.STIFF_IN_TIME
        ),
        "failed": Tried(Candidate({"b": 1}, "infinity"), None, None),
    }
    fit = SimpleNamespace(name="f", free=("a", "b", "w"), cost=2.0)
    found = Reduction(fit, fit, tuple(kinds[name] for name in tried), None, None)
    assert re.search(said, str(found))
    assert repr(found) == "<Reduction f, not reduced>"
    taken = tuple(replace(one, taken=True) for one in found.tried[:2])
    shown = "; ".join(
        {"rejected": "a = 0", "stiff": "w → ∞", "failed": "b → ∞"}[name] for name in tried[:2]
    )
    assert not taken or repr(replace(found, tried=taken)) == f"<Reduction f, {shown}>"
    rows = {
        line.split()[0]: line for line in str(found).splitlines()[2:] if "→" in line or "=" in line
    }
    assert ("rejected" in tried) == any(line.endswith("rejected") for line in rows.values())
    assert "failed" not in tried or rows["b"].split()[-2:] == ["-", "-"]


def test_what_the_problem_frees_stays_free_unless_it_is_gone():
    omega = np.array([0.5, 1.0, 2.0])
    data = gb.FrequencyResponse(omega, 1 / (1j * omega + 1), input="u", output="y")
    problem = gb.Problem(FastLag(), data, free=["tau"])
    fit = fitted_values(a=1.0, w=500.0, tau=0.01)
    fast = reduction._part_at_limit(problem, Candidate({"w": 1}, "infinity"), fit)
    assert {name for name, p in fast.parameters.items() if not p.fixed} == {"a", "tau"}
    prompt = reduction._part_at_limit(problem, Candidate({"tau": 1}, "zero"), fit)
    assert {name for name, p in prompt.parameters.items() if not p.fixed} == {"a", "w"}


def test_a_fit_without_an_estimate_is_not_reduced():
    lost = SimpleNamespace(name="lost", converged=False, status="no start converged")
    with pytest.raises(
        ValueError, match="the fit 'lost' has no estimate to reduce: no start converged"
    ):
        gb.validation.reduce(lost)
