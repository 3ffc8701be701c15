"""Fits of records, held against known truths, brute-force likelihoods, and fits that must give the same."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.optimize import minimize
from scipy.signal import lfilter, lsim

import greybox as gb
from greybox.models.controller import AttitudeController
from greybox.models.tilt import NonlinearTilt

HELD = gb.OutputError(inputs="held")
ONE = [{}]  # a single start, the declared one
FINE = gb.MultipleShooting(integrator=gb.RungeKutta(4))


class FullTilt(NonlinearTilt):
    """With the outputs of a flight log."""

    outputs = ("v", "q", "theta")

    def output(self, x, u, p):
        return (x.v, x.q, x.theta)


class Spring(gb.StateSpace):
    """A mass on a spring with damping, driven by a late force."""

    states = ("x", "v")
    inputs = ("F",)
    outputs = ("x", "v")
    delays = {"F": "d"}
    k = gb.Parameter(6.0, bounds=(0.1, 100), unit="1/s²")
    c = gb.Parameter(0.8, bounds=(0, 20), unit="1/s")
    b = gb.Parameter(1.5, bounds=(-50, 50), unit="1/kg")
    d = gb.Parameter(0.0, bounds=(0, 0.2), unit="s", fixed=True)

    def derivative(self, x, u, p):
        return (x.v, -p.k * x.x - p.c * x.v + p.b * u.F)

    def output(self, x, u, p):
        return (x.x, x.v)


class Lag(gb.TransferFunction):
    """First order with a delay."""

    K = gb.Parameter(1.0, bounds=(-20, 20))
    T = gb.Parameter(0.3, bounds=(0.01, 10), unit="s")
    d = gb.Parameter(0.0, bounds=(0, 0.5), unit="s", fixed=True)

    def response(self, s, p):
        return p.K / (p.T * s + 1) * gb.exp(-s * p.d)


TILT = {"a1": -2.0, "a2": 4.0, "a3": 3.0, "a4": 200.0, "C_x": 0.08, "T_rotor": 0.048, "T_delay": 0.0137}
SPRING = {"k": 9.0, "c": 1.2, "b": 4.0}
LAG = {"K": 3.0, "T": 0.2}


def fit(problem, starts=ONE, **options):
    return gb.fit(problem, starts=starts, progress=False, **options)


def deviations(found, truth):
    """Errors of the estimate in standard errors."""
    return {name: (found.estimate[name] - value) / found.standard_error[name] for name, value in truth.items()}


def assert_true(found, truth, most=3.5):
    assert found.converged
    off = deviations(found, truth)
    assert all(abs(z) < most for z in off.values()), off


def steps(n, seed=0, hold=8, channel=0):
    return np.repeat(np.random.default_rng([seed, channel, 77]).normal(size=n // hold + 1), hold)[:n]


def spring(n=300, rate=20.0, seed=0, noise=0.05, values=SPRING, force=None, **options):
    """A record of the spring with held forces, and white noise on both outputs."""
    force = steps(n, seed) if force is None else force
    sigma = {"x": noise, "v": 3 * noise}
    return gb.virtual_flight(Spring(), values, excitation={"F": force}, rate=rate, noise=sigma, seed=seed, **options)


def lag(delay, held, n=400, step=0.05, noise=0.0, seed=0, fine=100):
    """A record of the lag, exact: linear between points of a fine grid, on which the delay falls."""
    u = steps(n, seed, hold=3) if held else lfilter([1], [1, -0.6], np.random.default_rng(seed).normal(size=n))
    time = np.arange(n) * step
    late = np.arange((n - 1) * fine + 1) / fine - delay / step  # in samples
    if held:
        # The mean of every fine interval: what a held input does over it.
        between = late[:-1] + 0.5 / fine
        drive = LAG["K"] * u[np.clip(np.floor(between), 0, n - 1).astype(int)]
        decay = np.exp(-step / fine / LAG["T"])
        y = np.concatenate([[0.0], lfilter([1 - decay], [1, -decay], drive)])
    else:
        drive = np.interp(late, np.arange(n), u)
        y = lsim(([[-1 / LAG["T"]]], [[1 / LAG["T"]]], [[LAG["K"]]], 0), drive, late * step - late[0] * step)[1]
    error = noise * np.random.default_rng([seed, 1]).normal(size=n)
    return gb.Record(time, {"u": u, "y": y[::fine] + error})


def tilt_flight(seconds=60, seed=0):
    """The paper's closed loop with noise on all outputs, flown and logged at 100 Hz."""
    time, waves = np.arange(int(seconds * 100)) / 100, np.geomspace(0.5, 16, 9)
    phases = np.random.default_rng(5).uniform(0, 2 * np.pi, 9)
    reference = 0.08 * sum(np.sin(w * time + f) for w, f in zip(waves, phases, strict=True))
    noise = {"v": 0.05, "q": 0.02, "theta": 0.005}
    controller = AttitudeController(rate=100.0)
    return gb.virtual_flight(
        FullTilt(), TILT, excitation={"reference": reference}, controller=controller, noise=noise, seed=seed
    )


@pytest.fixture(scope="module")
def flight():
    return tilt_flight()


# --- the tilt plant in closed loop ------------------------------------------------------------------------------------


def test_every_parameter_of_a_flight_is_found(flight):
    problem = gb.Problem(FullTilt(), flight, HELD, free=("T_rotor", "T_delay"))
    near = [{"T_rotor": 0.03, "T_delay": 0.03, "a1": 10.0, "a2": 1.0, "a4": 300.0, "C_x": 0.5}]
    found = fit(problem, near)
    assert_true(found, TILT, 3.0)
    assert all(found.standard_error[name] < 0.05 * max(abs(value), 0.1) for name, value in TILT.items())
    assert found.records[0].fit_percent("theta") > 90
    assert_allclose(np.sqrt(np.diag(found.records[0].noise)), [0.05, 0.02, 0.005], rtol=0.05)


def test_a_lag_that_has_changed_places_with_another_is_put_back(flight):
    """The rotor's lag and the slow pole of the tilt may swap, and nearly all wide starts end there."""
    problem = gb.Problem(FullTilt(), flight, HELD, free=("T_rotor", "T_delay"))
    swapped = fit(problem, [{"T_rotor": 0.3}])
    assert swapped.estimate["T_rotor"] > 3 * TILT["T_rotor"]
    found = fit(problem, [{"T_rotor": 0.3}, {"T_rotor": 0.5}])
    assert found.cost < swapped.cost - 10
    assert_true(found, TILT, 3.0)
    assert len(found.runs) == 3
    assert any("only 1 of 3 starts reached the best minimum" in text for text in found.warnings)


def test_random_starts_in_wide_boxes_agree(flight):
    problem = gb.Problem(FullTilt(), flight, HELD, fixed={"T_rotor": TILT["T_rotor"]}, free=("T_delay",))
    found = fit(problem, 30)
    assert_true(found, {k: v for k, v in TILT.items() if k != "T_rotor"}, 3.0)
    assert found.agreeing >= 0.95 * 30


# --- delays -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("held", [False, True], ids=["linear", "held"])
@pytest.mark.parametrize("samples", [0.0, 0.13, 1.0, 1.5, 2.87, 3.0, 4.99])
def test_a_free_delay_is_found_to_a_tenth_of_a_sample(samples, held):
    data = lag(samples * 0.05, held, noise=0.01)
    problem = gb.Problem(Lag(), data, gb.OutputError(inputs="held" if held else "linear"), free=("d",))
    found = fit(problem, [{"d": 0.18}, {"d": 0.02}, {"d": 0.1}])
    assert found.converged
    assert abs(found.estimate["d"] / 0.05 - samples) < 0.1
    assert_allclose([found.estimate["K"], found.estimate["T"]], [3, 0.2], rtol=0.02)
    # A held input has a kink in the delay at whole samples, on both sides of which there may be a minimum.
    assert found.agreeing >= (1 if held and samples % 1 == 0 else 3)


class Direct(Lag):
    """Half of the input reaches the output directly."""

    def response(self, s, p):
        return (p.K / (p.T * s + 1) + 1) * gb.exp(-s * p.d)


def direct(samples, seed):
    """The lag of a held input and its input, which a sample sees as it was just before if the delay is a fraction."""
    data = lag(samples * 0.05, True, noise=0.01, seed=seed)
    late = np.clip(np.arange(len(data)) - int(np.ceil(samples - 1e-9)), 0, None)
    return data.with_signals(y=data["y"] + data["u"][late])


@pytest.mark.parametrize("samples", [0.0, 0.3, 1.5, 2.0])
def test_a_held_input_that_reaches_the_output_directly_has_the_value_before_its_late_change(samples):
    """The delay is then found within its sample; a mean of both values would draw it to the next whole one."""
    exact = direct(samples, 0)
    starts = [{"d": d} for d in (0.0, 0.02, 0.07, 0.12)]
    found = fit(gb.Problem(Direct(), exact, HELD, free=("d",)), starts)
    assert found.estimate["d"] / 0.05 == pytest.approx(samples, abs=0.06)
    assert_allclose([found.estimate["K"], found.estimate["T"]], [3, 0.2], rtol=0.03)
    assert np.nanmean(found.records[0].residual("y") ** 2) < 1.2 * 0.01**2
    assert any("the cost jumps where d passes a whole sample" in text for text in found.warnings)
    lone = fit(gb.Problem(Lag(), lag(samples * 0.05, True, noise=0.01), HELD, free=("d",)))
    assert not any("the cost jumps" in text for text in lone.warnings)
    simulated = gb.simulate(Direct(), {**LAG, "d": samples * 0.05}, exact, inputs="held")
    assert_allclose(simulated["y"][5:], exact["y"][5:], atol=0.05)  # five standard deviations of the noise


def test_a_delay_by_pade_states_is_nearly_the_same():
    data = lag(0.115, False, noise=0.005)
    exact, pade = (
        fit(gb.Problem(Lag(), data, free=("d",), delay=delay), [{"d": 0.1}]) for delay in ("exact", "pade:2")
    )
    assert_allclose(pade.estimate["d"], 0.115, atol=0.01)
    assert_allclose(pade.estimate["K"], exact.estimate["K"], rtol=0.02)
    assert_allclose(exact.estimate["d"], 0.115, atol=0.001)


# --- the likelihood ---------------------------------------------------------------------------------------------------


def simulated(record, k, c, b, x0, v0):
    """The spring with held forces, sample by sample with the matrix exponential: (2, n)."""
    step = record.step
    big = expm(step * np.array([[0, 1, 0], [-k, -c, b], [0, 0, 0]]))
    rows = np.empty((len(record), 2))
    x = rows[0] = np.array([x0, v0])
    A, B = big[:2, :2], big[:2, 2]
    for i, force in enumerate(record["F"][:-1]):
        rows[i + 1] = x = A @ x + B * force
    return rows.T


def brute_force(record, likelihood):
    """Minimize a likelihood of residuals (2, n) over parameters and initial states, by scipy alone."""
    y = np.array([record["x"], record["v"]])

    def cost(z):
        return likelihood(y - simulated(record, *z))

    return minimize(cost, [8.9, 1.2, 4.0, *(record[name][0] for name in "xv")], method="BFGS", options={"gtol": 1e-4})


def gaussian(residual, sigma):
    there = np.isfinite(residual)
    z = residual[there] / np.broadcast_to(np.array(sigma)[:, None], residual.shape)[there]
    return 0.5 * (z @ z) + (there * np.log(np.sqrt(2 * np.pi) * np.array(sigma))[:, None]).sum()


def diagonal(residual):
    sigma = np.sqrt(np.nanmean(residual**2, axis=1))
    return gaussian(residual, sigma)


def full(residual):
    n = residual.shape[1]
    return n / 2 * np.linalg.slogdet(residual @ residual.T / n)[1] + n * (np.log(2 * np.pi) + 1)


def correlated(seed=3, n=150):
    data = spring(n, noise=0.0, seed=seed, initial={"x": 0.4, "v": -0.5})
    error = np.array([[0.05, 0.0], [0.12, 0.05]]) @ np.random.default_rng(seed).normal(size=(2, n))
    return data.with_signals(x=data["x"] + error[0], v=data["v"] + error[1])


KNOWN = {"x": 0.05, "v": 0.13}


@pytest.mark.parametrize(
    ("noise", "likelihood"),
    [(KNOWN, lambda r: gaussian(r, [*KNOWN.values()])), ("diagonal", diagonal), ("full", full)],
    ids=["known", "diagonal", "full"],
)
def test_the_estimate_is_the_most_likely_one(noise, likelihood):
    data = correlated()
    wanted = brute_force(data, likelihood)
    found = fit(gb.Problem(Spring(), data, gb.OutputError(noise=noise, inputs="held")), method=FINE)
    assert_allclose([found.estimate[n] for n in SPRING], wanted.x[:3], rtol=2e-4)
    assert_allclose([found.records[0].initial[n][0] for n in "xv"], wanted.x[3:], atol=2e-3)
    assert_allclose(found.cost, wanted.fun, rtol=1e-6)


def test_missing_samples_are_left_out_of_the_likelihood():
    data = correlated()
    holes = {n: np.where(np.random.default_rng(k).random(150) < 0.3, np.nan, data[n]) for k, n in enumerate("xv")}
    data = data.with_signals(**holes)
    wanted = brute_force(data, diagonal)
    found = fit(gb.Problem(Spring(), data, HELD), method=FINE)
    assert_allclose([found.estimate[n] for n in SPRING], wanted.x[:3], rtol=2e-4)
    assert_allclose(found.cost, wanted.fun, rtol=1e-6)
    assert np.isnan(found.records[0].residual("x")[np.isnan(data["x"])]).all()


def test_standard_errors_are_those_of_the_brute_force_likelihood():
    data = spring(400, seed=2)
    wanted = brute_force(data, diagonal)
    found, h = fit(gb.Problem(Spring(), data, HELD)), 1e-4
    y = np.array([data["x"], data["v"]])
    columns = [
        (simulated(data, *(wanted.x + h * e)) - simulated(data, *(wanted.x - h * e))) / (2 * h) for e in np.eye(5)
    ]
    sigma = np.sqrt(np.mean((y - simulated(data, *wanted.x)) ** 2, axis=1))
    J = np.array([(c / sigma[:, None]).ravel() for c in columns]).T
    errors = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))[:3]
    assert_allclose([found.standard_error[n] for n in SPRING], errors, rtol=0.1)  # residuals nearly white
    assert_allclose(np.sqrt(np.diag(found.white)), errors, rtol=0.01)
