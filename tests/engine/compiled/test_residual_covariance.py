"""Covariances of residuals, held against densities by scipy and against the minimum that they
promise.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from scipy.stats import multivariate_normal, norm

import greybox as gb
from greybox.engine.compiled.residual_covariance import (
    ResidualCovariance,
    require_independent,
    residual_covariance_of,
)

pytestmark = pytest.mark.usefixtures("unjudged_file")

RANDOM = np.random.default_rng(0)
RESIDUALS = np.array([[1.0, 0.0, 0.0], [0.6, 0.5, 0.0], [0.0, -0.1, 2e-3]]) @ RANDOM.normal(
    size=(3, 400)
)
NAMES = ("a", "b", "c")
SIGMA = {"a": 0.8, "b": 0.5, "c": 0.02}


def made(noise, residuals=RESIDUALS):
    """The noise of outputs that are their own residuals, and the products of these."""
    there = np.nan_to_num(residuals)
    return residual_covariance_of(gb.OutputError(noise=noise), NAMES, residuals), there @ there.T


def holed(seed=1):
    values = RESIDUALS.copy()
    values[np.random.default_rng(seed).random(values.shape) < 0.3] = np.nan
    return values


def density(values, sigma):
    return -sum(
        norm.logpdf(v[np.isfinite(v)], scale=s).sum() for v, s in zip(values, sigma, strict=True)
    )


class Twins(gb.StateSpace):
    """A lag seen by three sensors, two of them alike."""

    states, inputs, outputs = ("x",), ("u",), ("x", "same", "other")
    a = gb.Parameter(1.0, bounds=(0.1, 20))

    def derivative(self, x, u, p):
        return (p.a * (u.u - x.x),)

    def output(self, x, u, p):
        return x.x, 2 * x.x, x.x


def twins(noise, **signals):
    random, n = np.random.default_rng(4), 300
    u = np.repeat(random.normal(size=n // 10), 10)
    flown = gb.simulate(
        Twins(), {"a": 3.0}, gb.Record(0.05 * np.arange(n), {"u": u}), inputs="held"
    )
    measured = {
        "x": flown["x"] + 0.05 * random.normal(size=n),
        "other": flown["other"] + 0.05 * random.normal(size=n),
    }
    measured["same"] = 2 * measured["x"] + 1e-3 * random.normal(size=n)
    made = {name: make(measured) for name, make in signals.items()}
    record = gb.Record(0.05 * np.arange(n), {"u": u} | measured | made)
    return gb.Problem(Twins(), record, gb.OutputError(noise=noise, inputs="held"))


@pytest.mark.parametrize(
    ("signals", "words"),
    [
        (
            {"same": lambda m: 2 * m["x"]},
            "x and same are exactly dependent in the record, one following from the other,",
        ),
        (
            {"same": lambda m: np.degrees(m["x"]).astype(np.float32) - 7},
            "x and same are exactly dependent",
        ),
        (
            {"same": lambda m: m["x"] - 3 * m["other"]},
            "x, same and other are exactly dependent in the record, one following from the others,",
        ),
    ],
    ids=["twice", "single precision", "sum"],
)
def test_outputs_that_are_exactly_dependent_are_named_with_the_cure(signals, words):
    with pytest.raises(
        ValueError, match=r"noise='diagonal', or leave one of them out\.$"
    ) as refused:
        gb.fit(twins("full", **signals), starts=1, progress=False)
    assert str(refused.value).startswith(words)
    assert gb.fit(twins("diagonal", **signals), starts=1, progress=False).runs[0].status


def test_outputs_with_errors_of_their_own_are_not_refused():
    """Two sensors whose errors are nearly one; the covariance is theirs."""
    fit = gb.fit(twins("full"), starts=1, progress=False)
    assert fit.converged
    noise = fit.records[0].noise
    errors = np.array([[1, 0, 0], [2, 1e-3 / 0.05, 0], [0, 0, 1]]) * 0.05
    assert_allclose(noise, errors @ errors.T, rtol=0.2, atol=3e-4)


@pytest.mark.parametrize("values", [RESIDUALS, holed()], ids=["whole", "holes"])
def test_given_deviations(values):
    noise, products = made(SIGMA, values)
    assert_allclose(noise.cost(products), density(values, SIGMA.values()))
    assert_allclose(np.sqrt(np.diag(noise.covariance(products))), [*SIGMA.values()])


@pytest.mark.parametrize("values", [RESIDUALS, holed()], ids=["whole", "holes"])
def test_estimated_variances_are_the_most_likely_ones(values):
    noise, products = made("diagonal", values)
    best = minimize(
        lambda z: density(values, np.exp(z)), np.log([*SIGMA.values()]), options={"gtol": 1e-8}
    )
    assert_allclose(noise.cost(products), best.fun, rtol=1e-9)
    assert_allclose(np.sqrt(np.diag(noise.covariance(products))), np.exp(best.x), rtol=1e-5)


def test_an_estimated_covariance_is_the_most_likely_one():
    noise, products = made("full")
    covariance = noise.covariance(products)
    assert_allclose(covariance, RESIDUALS @ RESIDUALS.T / 400, rtol=1e-6, atol=1e-12)
    cost = noise.cost(products)
    assert_allclose(cost, -multivariate_normal(cov=covariance).logpdf(RESIDUALS.T).sum())
    for seed in range(20):
        nudge = 1e-2 * np.random.default_rng(seed).normal(size=(3, 3))
        other = (np.eye(3) + nudge) @ covariance @ (np.eye(3) + nudge).T
        assert -multivariate_normal(cov=other).logpdf(RESIDUALS.T).sum() > cost


@pytest.mark.parametrize("choice", [SIGMA, "diagonal", "full"])
def test_weights_make_the_residuals_white(choice):
    noise, products = made(choice)
    weight = noise.weight(products)
    assert_allclose(weight.T @ weight @ noise.covariance(products), np.eye(3), atol=1e-9)


@pytest.mark.parametrize("choice", [SIGMA, "diagonal", "full"])
def test_the_gradient_of_the_cost_is_that_of_the_weighted_squares(choice):
    """Relaxation: with weights from the residuals the Gauss-Newton gradient is that of the
    likelihood.
    """
    noise, products = made(choice)
    direction, h = (
        np.random.default_rng(5).normal(size=RESIDUALS.shape) * RESIDUALS.std(axis=1)[:, None],
        1e-5,
    )
    moved = [RESIDUALS + k * h * direction for k in (-2, -1, 1, 2)]
    costs = np.array([noise.cost(r @ r.T) for r in moved])
    weight = noise.weight(products)
    assert_allclose(
        np.sum((weight @ RESIDUALS) * (weight @ direction)),
        costs @ [1, -8, 8, -1] / (12 * h),
        rtol=1e-6,
    )


@pytest.mark.parametrize("choice", ["diagonal", "full"])
def test_residuals_of_zero_leave_the_cost_finite(choice):
    noise, products = made(choice)
    assert np.isfinite(noise.cost(0 * products))
    assert np.all(np.isfinite(noise.weight(0 * products)))
    assert noise.cost(np.full((3, 3), np.inf)) == np.inf


@pytest.mark.parametrize("unit", [1e-6, 1e6])
@pytest.mark.parametrize("choice", ["diagonal", "full"])
def test_units_change_the_cost_by_a_constant(choice, unit):
    scale = np.array([1.0, unit, 1 / unit])[:, None]
    (plain, products), (scaled, other) = made(choice), made(choice, scale * RESIDUALS)
    shift = 400 * np.log(scale).sum()
    assert_allclose(scaled.cost(other) - shift, plain.cost(products))
    assert_allclose(scaled.cost(other / 4) - shift, plain.cost(products / 4))


def test_an_output_that_never_moves():
    values = np.vstack([np.ones(50), np.zeros(50), RESIDUALS[2, :50]])
    noise, products = made("diagonal", values)
    assert np.isfinite(noise.cost(products))


def test_a_predicted_covariance_is_that_of_the_density():
    predicted = np.array([[2.0, 0.3], [0.3, 0.5]])
    noise = ResidualCovariance(np.array([400, 400]), np.ones(2), None, True, predicted)
    values = RESIDUALS[:2]
    assert noise.cost(values @ values.T) == pytest.approx(
        -multivariate_normal(cov=predicted).logpdf(values.T).sum()
    )
    assert noise.covariance(values @ values.T) is predicted
    assert noise.cost(np.full((2, 2), np.nan)) == np.inf


@pytest.mark.parametrize("choice", [SIGMA, "diagonal", "full"])
def test_costs_of_records_add_and_each_has_a_covariance_of_its_own(choice):
    records = [RESIDUALS[:, :150], 3 * RESIDUALS[:, 150:], RESIDUALS[:, 5:25]]
    each = [made(choice, values) for values in records]
    together = ResidualCovariance(
        np.array([noise.counts for noise, _ in each]),
        np.array([n.spread for n, _ in each]),
        each[0][0].known,
        choice == "full",
    )
    products = np.array([product for _, product in each])
    assert together.cost(products) == pytest.approx(
        sum(noise.cost(product) for noise, product in each)
    )
    wanted = [noise.covariance(product) for noise, product in each]
    assert_allclose(together.covariance(products), wanted)
    assert_allclose(
        together.weight(products), [noise.weight(product) for noise, product in each], atol=1e-9
    )


def test_the_spread_of_what_is_missing_or_constant():
    values = np.array([[2.0, 2.0, np.nan], [np.nan] * 3, [0.0, 0.0, 0.0], [1.0, np.nan, 3.0]])
    noise = residual_covariance_of(gb.OutputError(), ("a", "b", "c", "d"), values)
    assert noise.spread.tolist() == [2, 1, 1, 1]
    assert noise.counts.tolist() == [2, 0, 3, 2]
    # Residuals of zero have the variance of rounding, beside the spread.
    assert_allclose(np.diag(noise.covariance(np.zeros((4, 4)))), 1e-18 * noise.spread**2)


@pytest.mark.parametrize(("apart", "refused"), [(3e-7, True), (3e-6, False)])
def test_outputs_are_dependent_where_single_precision_does_not_part_them(apart, refused):
    """Of two outputs of unit spread that differ by this, the combination that is nearly
    constant has half of it.
    """
    random = np.random.default_rng(0)
    x = random.normal(size=500)
    # A third that is independent takes no part, nor does one that never moves, and rows with holes
    # do not count.
    measured = np.array(
        [1e4 * x, np.ones(500), random.normal(size=500), x + apart * random.normal(size=500)]
    )
    measured[3, :30] = np.nan
    if refused:
        with pytest.raises(
            ValueError,
            match=r"^a and d are exactly dependent in the record, one following from the",
        ):
            require_independent(("a", "b", "c", "d"), measured)
    else:
        require_independent(("a", "b", "c", "d"), measured)
    require_independent(("a", "d"), np.array([[1.0, 2.0], [2.0, 4.0]]))  # of two samples, all are


@pytest.mark.parametrize(("noise", "count"), [(SIGMA, 0), ("full", 6), ("diagonal", 3)])
def test_a_covariance_of_three_outputs_has_six_numbers_or_three(noise, count):
    assert made(noise)[0].unknowns == count


def test_a_weight_follows_order_and_units_of_the_outputs():
    """Standard errors weigh outputs one by one, so that another root would give other ones."""
    covariance, products = made("full")
    weight = covariance.weight(products)
    inverse = np.linalg.inv(covariance.covariance(products))
    assert_allclose(weight.T @ weight, inverse, rtol=1e-9)
    order, units = [2, 0, 1], np.array([1e3, 1.0, 1e-2])
    other = RESIDUALS[order] * units[:, None]
    covariance, products = made("full", other)
    assert_allclose(covariance.weight(products), weight[np.ix_(order, order)] / units, rtol=1e-7)
