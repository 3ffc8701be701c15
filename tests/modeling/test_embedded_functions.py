"""CasADi functions that stay calls within a model, against the formula that they stand for."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

GRID = np.linspace(-20, 20, 801)
TRUTH = {"k": 2.0, "a": 0.8}


class PythonTanh(ca.Callback):
    """tanh(scale y), computed by Python."""

    def __init__(self, scale=1.0):
        self.scale = scale
        ca.Callback.__init__(self)
        self.construct("python_tanh", {"enable_fd": True})

    def get_n_in(self):
        return 1

    def get_n_out(self):
        return 1

    def eval(self, arguments):
        return [np.tanh(self.scale * float(arguments[0]))]


def root():
    y, z = ca.SX.sym("y"), ca.SX.sym("z")
    function = ca.rootfinder("root", "newton", {"x": z, "p": y, "g": z - ca.tanh(y)})
    return lambda y: function(0, y)


def integral():
    """The state z' = tanh(y) at t = 1."""
    y, z = ca.SX.sym("y"), ca.SX.sym("z")
    function = ca.integrator(
        "integral",
        "rk",
        {"x": z, "p": y, "ode": ca.tanh(y)},
        0,
        1,
        {"number_of_finite_elements": 2},
    )
    return lambda y: function(x0=0, p=y)["xf"]


def never_inlined():
    y = ca.SX.sym("y")
    inner = ca.Function("inner", [y], [ca.tanh(y), y], {"never_inline": True})
    outer = ca.Function("outer", [y], [y, inner(y)[0]], {"never_inline": True})
    return lambda y: outer(y)[1]


FUNCTIONS = {
    "linear table": lambda: ca.interpolant("f", "linear", [GRID], np.tanh(GRID)),
    "spline table": lambda: ca.interpolant("f", "bspline", [GRID], np.tanh(GRID)),
    "never inlined": never_inlined,
    "root": root,
    "integral": integral,
    "callback": PythonTanh,
}
# The error of the linear table is curvature times step squared over 8: 2.4e-4.
TOLERANCE = {"linear table": 5e-4, "callback": 1e-6}

embedded = pytest.mark.parametrize("name", FUNCTIONS)


def lag(function):
    class Lag(gb.StateSpace):
        """y' = k u - a f(y)."""

        states = outputs = ("y",)
        inputs = ("u",)
        k = gb.Parameter(1.5, bounds=(0, 5))
        a = gb.Parameter(1.0, bounds=(0.1, 5))

        def derivative(self, x, u, p):
            return (p.k * u.u - p.a * function(x.y),)

        def output(self, x, u, p):
            return (x.y,)

    return Lag()


def flight(samples=60):
    time = np.arange(samples) * 0.1
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], samples // 10), 10)
    return gb.Record(time, {"u": u}, hold={"u": np.inf})


def measured(record, seed=1):
    """The record with the measured motion of the plain formula."""
    y = gb.simulate(lag(gb.tanh), TRUTH, record=record)["y"]
    y = y + 0.01 * np.random.default_rng(seed).standard_normal(len(record))
    return gb.Record(record.time, {"u": record["u"], "y": y}, hold={"u": np.inf, "y": 0.0})


def response():
    omega = np.geomspace(0.3, 10, 8)
    exact = TRUTH["k"] / (1j * omega + TRUTH["a"])
    wrong = 1 + 0.01 * np.cos(7 * omega)
    return gb.FrequencyResponse(omega, exact * wrong, input="u", output="y")


@embedded
def test_a_simulation_is_that_of_the_formula(name):
    function = FUNCTIONS[name]()

    class Decay(gb.StateSpace):
        """y' = 1 - k f(y)."""

        states = outputs = ("y",)
        inputs = ()
        k = gb.Parameter(0.8, bounds=(0, 5))

        def derivative(self, x, u, p):
            return (1 - p.k * function(x.y),)

        def output(self, x, u, p):
            return (x.y,)

    time = np.linspace(0, 10, 101)
    record = gb.Record(time, {"unused": 0 * time})
    exact = solve_ivp(
        lambda t, y: 1 - 0.8 * np.tanh(y), (0, 10), [0], t_eval=time, rtol=1e-9, atol=1e-12
    )
    simulated = gb.simulate(Decay(), {"k": 0.8}, record=record)["y"]
    assert_allclose(simulated, exact.y[0], rtol=TOLERANCE.get(name, 1e-5))


@embedded
def test_a_response_is_that_of_the_formula(name):
    """About y = 0.4, where the slope of tanh is 1 - tanh(0.4)²."""
    omega = np.array([0.3, 1.0, 3.0])
    model = lag(FUNCTIONS[name]())
    exact = TRUTH["k"] / (1j * omega + TRUTH["a"] * (1 - np.tanh(0.4) ** 2))
    # The slope of the linear table changes from interval to interval, by the step times curvature.
    rtol = 0.03 if name == "linear table" else 1e-4
    response = gb.frequency_response(model, TRUTH, omega, at={"y": 0.4}).response
    assert_allclose(response, exact, rtol=rtol)


@embedded
@pytest.mark.parametrize("data", [response(), measured(flight())], ids=["response", "record"])
def test_a_fit_is_that_of_the_formula(name, data):
    start = [{"k": 1.5, "a": 1.0}]
    plain = gb.fit(gb.Problem(lag(gb.tanh), data), start, progress=False, profiles=False)
    problem = gb.Problem(lag(FUNCTIONS[name]()), data)
    fit = gb.fit(problem, start, progress=False, profiles=False)
    # At y = 0 the slope of the linear table is that of an interval, 1 - step²/3.
    share = 0.5 if name == "linear table" else 0.05
    for parameter, error in plain.standard_error.items():
        difference = fit.estimate[parameter] - plain.estimate[parameter]
        assert abs(difference) < share * error
        assert fit.standard_error[parameter] == pytest.approx(error, rel=0.02)


def test_a_model_with_a_table_is_fitted_in_workers():
    problem = gb.Problem(lag(FUNCTIONS["spline table"]()), measured(flight()))
    starts = [{"k": 1.5, "a": 1.0}, {"k": 2.5, "a": 0.5}, {"k": 1.0, "a": 2.0}]
    here = gb.fit(problem, starts, progress=False, profiles=False)
    with gb.solve.WorkerPool(1) as workers:
        there = gb.fit(problem, starts, executor=workers, progress=False, profiles=False)
    assert there.estimate == here.estimate


def test_callbacks_of_one_name_are_two_functions():
    """CasADi's text of a callback says nothing of what it does."""
    for scale in (1.0, 3.0):
        model = lag(PythonTanh(scale))
        omega = np.array([0.5, 2.0])
        exact = TRUTH["k"] / (1j * omega + scale * TRUTH["a"])
        data = gb.FrequencyResponse(omega, exact, input="u", output="y")
        assert gb.cost(gb.Problem(model, data), TRUTH) < 1e-4
        plain = lag(lambda y, s=scale: gb.tanh(s * y))
        y = gb.simulate(plain, TRUTH, record=flight())["y"]
        assert_allclose(gb.simulate(model, TRUTH, record=flight())["y"], y, atol=1e-6)


@pytest.mark.parametrize("data", [response(), measured(flight())], ids=["response", "record"])
def test_a_callback_stays_in_this_process(data, tmp_path):
    problem = gb.Problem(lag(PythonTanh()), data)
    sentence = r"callback 'python_tanh' of the model cannot be sent to another process or stored: "
    with gb.solve.WorkerPool(1) as workers, pytest.raises(ValueError, match=sentence):
        gb.fit(problem, 3, executor=workers, progress=False)
    study = gb.batch([gb.study.Member(problem, starts=3)], tmp_path / "study", progress=False)
    assert "python_tanh" in str(study)
