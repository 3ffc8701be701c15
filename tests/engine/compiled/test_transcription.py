"""Single shooting, multiple shooting and direct collocation are interchangeable on one problem."""

import numpy as np
import pytest

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Cart(gb.StateSpace):
    """A mass on a spring with quadratic drag."""

    states = ("x", "v")
    inputs = ("u",)
    outputs = ("x", "v")
    k = gb.Parameter(3.0, bounds=(0.1, 50), unit="1/s²", starts=(1, 20))
    c = gb.Parameter(0.5, bounds=(0, 5), unit="1/m")
    b = gb.Parameter(1.0, bounds=(0.1, 10), unit="m/s²")
    tau = gb.Parameter(0.05, bounds=(0, 0.2), unit="s", fixed=True)
    delays = {"u": "tau"}

    def derivative(self, x, u, p):
        return (x.v, -p.k * x.x - p.c * abs(x.v) * x.v + p.b * u.u)

    def output(self, x, u, p):
        return (x.x, x.v)


TRUTH = {"k": 4.0, "c": 0.8, "b": 2.0, "tau": 0.053}
RATE = 50.0


def flown(samples=150, seed=0):
    """A record made without the estimator: scipy's integrator on the held, delayed input."""
    from scipy.integrate import solve_ivp

    random = np.random.default_rng(seed)
    u = np.repeat(random.normal(size=samples // 10 + 2), 10)[:samples]
    time = np.arange(samples) / RATE

    def derivative(t, x):
        late = u[int(np.clip(np.floor((t - TRUTH["tau"]) * RATE + 1e-9), 0, samples - 1))]
        return [x[1], -TRUTH["k"] * x[0] - TRUTH["c"] * abs(x[1]) * x[1] + TRUTH["b"] * late]

    found = solve_ivp(derivative, (0, time[-1]), [0.5, 0.0], t_eval=time, max_step=1e-2, rtol=1e-8)
    noisy = found.y + 0.01 * random.normal(size=found.y.shape)
    return gb.Record(
        time,
        {"u": u, "x": noisy[0], "v": noisy[1]},
        units={"u": "1", "x": "m", "v": "m/s"},
        name="cart",
    )


RECORD = flown(100)
FINE = gb.RungeKutta(substeps=4)
METHODS = (
    gb.MultipleShooting(integrator=FINE),
    gb.MultipleShooting(integrator=FINE, segment=4),
    gb.MultipleShooting(integrator=FINE, ipopt=True),
    gb.MultipleShooting(integrator=FINE, hessian="exact"),
    gb.SingleShooting(integrator=FINE),
    gb.SingleShooting(integrator=FINE, hessian="exact"),
    gb.Collocation(),
    gb.Collocation(hessian="exact"),
    gb.MultipleShooting(integrator=gb.Radau()),
)


def problem(**options):
    noise = options.pop("noise", "diagonal")
    return gb.Problem(
        Cart(), RECORD, criterion=gb.OutputError(noise=noise, inputs="held"), **options
    )


@pytest.fixture(scope="module")
def reference():
    return gb.fit(problem(free=["tau"]), starts=[{}], method=METHODS[0])


@pytest.mark.parametrize("method", METHODS[1:], ids=repr)
def test_all_methods_find_one_minimum(method, reference):
    fit = gb.fit(problem(free=["tau"]), starts=[{}], method=method)
    assert fit.converged, fit.status
    for name in fit.free:
        assert (
            abs(fit.estimate[name] - reference.estimate[name])
            < 0.02 * reference.standard_error[name]
        ), name
        assert fit.standard_error[name] == pytest.approx(reference.standard_error[name], rel=0.02)
    assert fit.cost == pytest.approx(reference.cost, abs=2e-3)
    assert method.label in fit.records[0].method


def test_the_truth_is_found(reference):
    for name in reference.free:
        assert abs(reference.estimate[name] - TRUTH[name]) < 3 * reference.standard_error[name], (
            name
        )


@pytest.mark.parametrize("noise", ["full", {"x": 0.01, "v": 0.02}], ids=str)
def test_relaxation_ends_where_the_likelihood_does(noise):
    """IPOPT with fixed weights, renewed until they agree, against descent on the determinant
    itself.
    """
    descended, relaxed = (
        gb.fit(problem(noise=noise), starts=[{}], method=m)
        for m in (gb.MultipleShooting(), gb.MultipleShooting(ipopt=True))
    )
    assert descended.cost == pytest.approx(relaxed.cost, abs=1e-6)
    for name in descended.free:
        assert descended.estimate[name] == pytest.approx(
            relaxed.estimate[name], abs=1e-4 * descended.standard_error[name]
        )


@pytest.fixture(scope="module")
def constrained():
    """A problem with a tie, a constraint and a known initial state, and its usual fit."""
    known = gb.OutputError(
        noise={"x": 0.01, "v": 0.01}, inputs="held", initial={"x": lambda p: 0.125 * p.k}
    )
    tied, constraints = {"b": lambda p: 0.4 * p.k}, [lambda p: 3.5 - p.k]
    stated = gb.Problem(Cart(), RECORD, criterion=known, tied=tied, constraints=constraints)
    return stated, gb.fit(stated, starts=[{}])


@pytest.mark.parametrize("method", METHODS[4:8:2], ids=repr)
def test_constraints_ties_bounds_and_known_states_hold_for_all(method, constrained):
    stated, usual = constrained
    other = gb.fit(stated, starts=[{}], method=method)
    assert usual.estimate["k"] == pytest.approx(3.5, abs=1e-5)
    assert usual.estimate["b"] == pytest.approx(1.4, abs=1e-5)
    assert usual.records[0].initial["x"][0] == pytest.approx(3.5 / 8, abs=1e-6)
    assert other.estimate["c"] == pytest.approx(usual.estimate["c"], abs=1e-4)
    assert other.cost == pytest.approx(usual.cost, rel=3e-5)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: gb.MultipleShooting(segment=0), "segment is 0: give a whole number"),
        (
            lambda: gb.SingleShooting(hessian="newton"),
            "hessian 'newton' is not known: use 'gauss-newton' or 'exact'",
        ),
        (lambda: gb.Collocation(degree=12), "degree is 12: give a whole number from 1 to 9"),
        (lambda: gb.MultipleShooting(integrator="rk4"), "integrator is 'rk4': give RungeKutta"),
        (lambda: gb.RungeKutta(substeps=0), "substeps is 0: give a whole number"),
    ],
)
def test_bad_options_are_named(make, words):
    with pytest.raises((ValueError, TypeError), match=words):
        make()


def test_a_warning_names_what_was_chosen_and_what_is_to_be_changed():
    assert (
        gb.MultipleShooting().finer(4)
        == f"method=MultipleShooting(integrator={gb.RungeKutta(4)!r})"
    )
    chosen = gb.MultipleShooting(segment=1, integrator=gb.RungeKutta(2))
    assert chosen.finer(8) == f"method=MultipleShooting(segment=1, integrator={gb.RungeKutta(8)!r})"
    assert chosen.described(1, 2).endswith(
        "1 sample per segment, " + f"{gb.RungeKutta().name}, 2 steps per sample"
    )
