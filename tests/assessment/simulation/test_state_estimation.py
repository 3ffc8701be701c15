"""States of lead-ins: least squares and Gaussian conditioning written out.

Models that are not finite everywhere.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.assessment.simulation import state_estimation
from greybox.assessment.simulation.state_estimation import estimate_states, one_step_errors


class Tanks(gb.StateSpace):
    """Two tanks below one another by Torricelli's law, of which the lower level is measured."""

    states, inputs, outputs = ("upper", "lower"), ("flow",), ("lower",)
    k1 = gb.Parameter(0.5, bounds=(0.1, 2))
    k2 = gb.Parameter(0.6, bounds=(0.1, 2))

    def root(self, level):
        return gb.sqrt(level)

    def derivative(self, x, u, p):
        between = p.k1 * self.root(x.upper)
        return (u.flow - between, between - p.k2 * self.root(x.lower))

    def output(self, x, u, p):
        return (x.lower,)


class SafeTanks(Tanks):
    """The same with roots below zero."""

    def root(self, level):
        return gb.sqrt(gb.maximum(level, 0))


def tanks(model, flow, noise=0.02):
    record = gb.Record(np.arange(flow.size) / 5.0, {"flow": flow}, name="tanks")
    lower = gb.simulate(model, {}, record, initial={"upper": 2.0, "lower": 1.5})["lower"]
    return record.with_signals(
        lower=lower + noise * np.random.default_rng(0).normal(size=flow.size)
    )


def test_lead_ins_stay_where_the_model_is_finite():
    flow = 0.6 + 0.3 * np.repeat(np.random.default_rng(1).uniform(-1, 1, 25), 20)
    record = tanks(Tanks(), flow)
    found = gb.predict(Tanks(), {}, record, horizon=2.0, lead=6.0)
    exact = gb.simulate(Tanks(), {}, record, initial={"upper": 2.0, "lower": 1.5})["lower"][
        found.rows
    ]
    assert np.sqrt(np.mean((found.predicted[0] - exact) ** 2)) < 0.02
    assert np.all(found.trajectory > 0)


def test_what_is_not_finite_is_named_with_its_place():
    flow = np.where(np.arange(200) < 150, 0.6, 0.0)
    record = tanks(SafeTanks(), flow)
    with pytest.raises(
        ValueError,
        match=r"not finite in \d+ windows of 38: (upper|lower) at 3\d\.?\d* s",
    ):
        gb.predict(Tanks(), {}, record, horizon=1.0, lead=2.0, integrator=gb.RungeKutta(substeps=8))
    with pytest.raises(
        ValueError,
        match=r"diverges at 3\d\.?\d* s, \w+ first: .*gb.maximum",
    ):
        gb.simulate(Tanks(), {}, record, initial={"upper": 2.0, "lower": 1.5})


# --- a linear model, of which everything is known


SAMPLES, OUTPUTS, STATES = 6, 2, 3


def linear(windows, seed=0):
    """Outputs C_t x of every window, with the same C for all, one of the states the more certain."""
    random = np.random.default_rng(seed)
    C = random.normal(size=(SAMPLES, OUTPUTS, STATES))
    truth = np.array([5.0, -2.0, 1.0]) + random.normal(size=(windows, STATES)) * [1.0, 0.5, 2.0]
    return C, truth, random


def estimated(C, measured, noise):
    windows = len(measured)
    present = np.isfinite(measured)
    return estimate_states(
        lambda x: np.einsum("tkn,wn->wtk", C, x),
        lambda x: np.where(present[..., None], C, 0.0),
        measured,
        np.zeros((windows, STATES)),
        noise,
        np.nanstd(measured, axis=(0, 1)),
    )


def test_a_few_windows_are_weighted_least_squares():
    """With fewer than ten windows the prior stays so weak that it does not matter."""
    C, truth, random = linear(3)
    noise = np.array([[0.01, 0.004], [0.004, 0.04]])
    errors = random.multivariate_normal(np.zeros(2), noise, size=(3, SAMPLES))
    measured = np.einsum("tkn,wn->wtk", C, truth) + errors
    found = estimated(C, measured, noise)
    weight = np.linalg.inv(noise)
    H = np.einsum("tki,kl,tlj->ij", C, weight, C)
    wanted = np.linalg.solve(H, np.einsum("tki,kl,wtl->iw", C, weight, measured)).T
    assert_allclose(found.states, wanted, atol=0.02 * np.sqrt(np.diag(np.linalg.inv(H))).max())
    assert not found.not_finite.any()


def test_many_windows_tell_their_prior_and_the_noise():
    C, truth, random = linear(400)
    measured = np.einsum("tkn,wn->wtk", C, truth) + random.normal(size=(400, SAMPLES, OUTPUTS)) * [
        0.3,
        0.6,
    ]
    measured[:, 2, 1] = np.nan
    found = estimated(C, measured, None)
    assert_allclose(found.mean, [5, -2, 1], atol=0.3)
    assert_allclose(1 / np.sqrt(found.precision), [1.0, 0.5, 2.0], rtol=0.15)
    # What the states have fitted away is shared between the outputs by number, not by what each
    # tells of the states.
    assert_allclose(np.sqrt(np.diag(found.noise)), [0.3, 0.6], rtol=0.15)
    H, _ = state_estimation.information_of(
        np.zeros_like(measured),
        np.where(np.isfinite(measured)[..., None], C, 0.0),
        found.noise,
    )
    covariance = np.linalg.inv(H + np.diag(found.precision))
    error = (found.states - truth) / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert_allclose(error.std(axis=0), 1, rtol=0.15)


def test_one_step_errors_are_those_of_gaussian_conditioning():
    """The joint covariance of all measurements, factored.

    Its Cholesky factor whitens them one after another.
    """
    C, truth, random = linear(4)
    noise, precision, mean = (
        np.array([0.2, 0.5]),
        np.array([1.0, 4.0, 0.25]),
        np.array([5.0, -2.0, 1.0]),
    )
    measured = np.einsum("tkn,wn->wtk", C, truth) + random.normal(
        size=(4, SAMPLES, OUTPUTS)
    ) * np.sqrt(noise)
    measured[1, 3] = np.nan
    about = random.normal(
        size=(4, STATES)
    )  # the trajectory about which everything is linear does not matter
    residual = measured - np.einsum("tkn,wn->wtk", C, about)
    slopes = np.broadcast_to(C, (4, *C.shape))
    found = one_step_errors(residual, slopes, mean - about, precision, np.diag(noise))
    for w in range(4):
        y = measured[w].ravel()
        present = np.isfinite(y)
        H = C.reshape(-1, STATES)[present]
        covariance = H @ np.diag(1 / precision) @ H.T + np.diag(np.tile(noise, SAMPLES)[present])
        wanted = np.linalg.solve(np.linalg.cholesky(covariance), y[present] - H @ mean)
        assert_allclose(found[w].ravel()[present], wanted, rtol=1e-9)
        assert np.isnan(found[w].ravel()[~present]).all()


def test_windows_that_are_not_finite_anywhere_are_named():
    C, truth, _ = linear(3)
    measured = np.einsum("tkn,wn->wtk", C, truth)
    found = estimate_states(
        lambda x: np.full((3, SAMPLES, OUTPUTS), np.nan),
        lambda x: np.full((3, SAMPLES, OUTPUTS, STATES), np.nan),
        measured,
        np.zeros((3, STATES)),
        np.eye(2),
        np.ones(2),
    )
    assert found.not_finite.all()
    assert np.isnan(found.mean).all()


@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_predictions_do_not_depend_on_the_unit_of_an_output(unit):
    class Lag(gb.StateSpace):
        states, inputs, outputs = ("x",), ("u",), ("y",)
        scale = gb.Parameter(1.0, fixed=True)

        def derivative(self, x, u, p):
            return (u.u - x.x,)

        def output(self, x, u, p):
            return (p.scale * x.x,)

    u = np.repeat(np.random.default_rng(0).normal(size=20), 20)
    record = gb.Record(np.arange(400) * 0.05, {"u": u})
    noise = 0.1 * np.random.default_rng(1).normal(size=400)
    y = gb.simulate(Lag(), {}, record)["y"] + noise
    plain, scaled = (
        gb.predict(
            Lag(), {"scale": size}, record.with_signals(y=size * y), horizon=1.0, lead=2.0
        ).predicted[0]
        / size
        for size in (1.0, unit)
    )
    assert_allclose(scaled, plain, atol=1e-6 * np.std(y))


def test_rows_have_the_mean_square_of_each_output_as_noise():
    class Two(gb.StateSpace):
        states, inputs, outputs = (), ("u",), ("y", "z")

        def output(self, x, u, p):
            return (u.u, 2 * u.u)

    errors = np.array([[1.0, 4.0], [3.0, np.nan], [2.0, np.nan]])
    u = np.array([0.3, -1.0, 2.0])
    rows = gb.Record(None, {"u": u, "y": u + errors[:, 0], "z": 2 * u + errors[:, 1]})
    found = gb.predict(Two(), {}, rows)
    assert_allclose(found.noise, np.diag([14 / 3, 16.0]), rtol=1e-9)
    assert found.trajectory.shape == (0, 3, 1)


def test_the_prior_of_few_windows_is_as_weak_as_the_spread_of_the_outputs():
    """As many numbers as are measured in a window, each with its spread over its noise."""
    random = np.random.default_rng(0)
    J = 0.2 * random.normal(size=(2, 6, 3))
    H = J.transpose(0, 2, 1) @ J
    H[:, 2], H[:, :, 2] = 0.0, 0.0  # a state that nothing shows
    measured = np.ones((2, 4, 2))
    measured[0, :2, 1] = np.nan
    mean = np.array([1.0, 2.0, 3.0])
    R, spread = np.diag([0.5, 0.25]), np.array([2.0, 3.0])
    same, precision = state_estimation.shared_prior(H, np.zeros((2, 3)), mean, measured, R, spread)
    signal = 4 * 2.0**2 / 0.5 + 3 * 3.0**2 / 0.25
    assert_allclose(precision, [*np.mean(H.diagonal(axis1=1, axis2=2), axis=0)[:2] / signal, 1.0])
    assert_allclose(same, mean)


def test_the_noise_is_that_of_the_residuals_less_what_the_states_have_fitted_away():
    random = np.random.default_rng(1)
    e, S = random.normal(size=(3, 5, 2)), random.normal(size=(3, 5, 2, 2))
    present = np.ones((3, 5, 2), dtype=bool)
    present[0, :3, 1] = False
    e[~present], S[~present] = 0.0, 0.0
    R, posterior = np.diag([0.5, 2.0]), np.array([np.eye(2) * c for c in (0.05, 0.1, 0.02)])
    found = state_estimation.residual_noise(e, S, present, posterior, R)
    fitted = (
        sum(
            (S[w, t, j] @ posterior[w] @ S[w, t, j]) / R[j, j]
            for w in range(3)
            for t in range(5)
            for j in range(2)
        )
        / present.sum()
    )
    assert 0.05 < fitted < 0.9
    assert_allclose(found, np.diag((e**2).sum(axis=(0, 1)) / [15, 12] / (1 - fitted)), rtol=1e-6)
    e[..., 1], S[..., 1, :], present[..., 1] = 0.0, 0.0, False  # an output that was not measured
    found = state_estimation.residual_noise(e, S, present, posterior, R)
    assert found[1, 1] == 0
    # What many states fit away leaves a tenth of the freedom at least.
    found = state_estimation.residual_noise(e, S, present, 1e3 * posterior, R)
    assert found[0, 0] == pytest.approx((e[..., 0] ** 2).sum() / (15 * 0.1))


def test_the_prior_of_many_windows_is_that_of_their_states():
    """Where each window tells its state well, mean and variance of these.

    A state that nothing shows has none.
    """
    random = np.random.default_rng(3)
    w = 60
    x = np.array([3.0, -1.0]) + random.normal(size=(w, 2)) * [2.0, 0.5]
    H = np.broadcast_to(np.diag([1e6, 1e6]), (w, 2, 2))
    measured = np.ones((w, 4, 1))
    information = np.einsum("wij,wj->wi", H, x)
    mean, precision = state_estimation.shared_prior(
        H, information, np.zeros(2), measured, np.eye(1), np.array([100.0])
    )
    assert_allclose(mean, x.mean(axis=0), rtol=1e-4)
    assert_allclose(precision, (w - 1) / ((x - x.mean(axis=0)) ** 2).sum(axis=0), rtol=1e-3)
    for few, told in ((9, False), (10, True)):  # below ten their states do not determine a spread
        mean, _ = state_estimation.shared_prior(
            H[:few], information[:few], np.zeros(2), measured[:few], np.eye(1), np.array([100.0])
        )
        assert_allclose(mean, x[:few].mean(axis=0) if told else 0.0, rtol=1e-4)


def test_information_is_weighted_by_correlated_noise():
    random = np.random.default_rng(4)
    e, S = random.normal(size=(2, 3, 2)), random.normal(size=(2, 3, 2, 4))
    R = np.array([[0.5, 0.3], [0.3, 0.7]])
    H, b = state_estimation.information_of(e, S, R)
    weight = np.linalg.inv(R)
    for w in range(2):
        assert_allclose(H[w], sum(S[w, t].T @ weight @ S[w, t] for t in range(3)))
        assert_allclose(b[w], sum(S[w, t].T @ weight @ e[w, t] for t in range(3)))
