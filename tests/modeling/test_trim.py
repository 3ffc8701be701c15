"""Operating points: the pitch ODE (4.23) in hover and in forward flight, derivatives, and what is refused."""

import casadi as ca
import numpy as np
import pytest
from evaluation import numeric_jacobian, response_formula
from numpy.testing import assert_allclose

import greybox as gb
from greybox.modeling.trim import trim_of
from greybox.models.multirotor import Torques
from greybox.models.tilt import PAPER_G, NonlinearTilt
from greybox.models.yaw import YawStates

OMEGA = np.geomspace(0.3, 40, 6)
START = np.array([q.start for q in NonlinearTilt().parameters.values()])
AWAY = START * np.array([1, 0.5, 2, 1.3, 1.1, 0.7, 3]) + np.array([-14, 0, 0, 0, 0, 0, 0])


def closed_form(p, theta):
    """Real and imaginary part of (4.25) with the drag slope 2 C_x |v0| and g / cos² θ, by hand."""
    a1, a2, a3, a4, T_rotor, T_delay, C_x = p
    s = 1j * OMEGA
    drag = 2 * np.sqrt(C_x * PAPER_G * np.tan(abs(theta)))
    tilt = (s + drag) / ((s + drag) * (s**2 + a2 * s + a1) + PAPER_G * a3 / np.cos(theta) ** 2)
    response = a4 * tilt / (T_rotor * s + 1) * np.exp(-s * T_delay)
    return np.concatenate([response.real, response.imag])


class OwnTrim(NonlinearTilt):
    """The pitch ODE with its trim in closed form."""

    def trim(self, at, p):
        v = (
            gb.sign(at.theta) * gb.sqrt(PAPER_G * gb.tan(abs(at.theta)) / p.C_x)
            if at.theta
            else 0.0
        )
        u = (p.a1 * at.theta + p.a3 * v) / p.a4
        return {"v": v, "rotor": u, "u": u}


def compiled(model, at):
    """The response as one column and its Jacobian and weighted Hessian, as functions of the parameters."""
    p = ca.MX.sym("p", len(START))
    column = ca.vertcat(*response_formula(model, OMEGA, output="theta", at=at).closed()(p))
    weights = ca.DM(np.cos(np.arange(column.numel())))
    hessian = ca.hessian(ca.dot(weights, column), p)[0]
    functions = [ca.Function("f", [p], [e]) for e in (column, ca.jacobian(column, p), hessian)]
    return [lambda x, f=f: np.asarray(f(x)) for f in functions], np.asarray(weights).ravel()


@pytest.mark.parametrize("model", [NonlinearTilt(), OwnTrim()], ids=repr)
@pytest.mark.parametrize("degrees", [0, 5, -5])
@pytest.mark.parametrize("p", [START, AWAY], ids=["start", "away"])
def test_response_jacobian_and_hessian_through_the_trim(model, degrees, p):
    theta = float(np.radians(degrees))
    (value, jacobian, hessian), weights = compiled(model, {"theta": theta})
    assert_allclose(value(p).ravel(), closed_form(p, theta), rtol=1e-9)

    def gradient(q):
        return weights @ numeric_jacobian(lambda r: closed_form(r, theta), q, 1e-3)

    wanted = numeric_jacobian(lambda q: closed_form(q, theta), p, 1e-3)
    assert_allclose(
        jacobian(p), wanted, rtol=1e-6, atol=1e-7 * np.abs(wanted).max(axis=0).min(initial=1)
    )
    wanted = numeric_jacobian(gradient, p, 1e-3)
    # Differences of differences have rounding of 1e-7 of the largest.
    assert_allclose(hessian(p), wanted, rtol=1e-5, atol=1e-6 * np.abs(wanted).max())
    assert (np.count_nonzero(jacobian(p)[:, -1]) == 0) == (
        degrees == 0
    )  # C_x, which hover does not show


@pytest.mark.parametrize("theta", [1e-6, 1e-3, -0.5, 1.5])
@pytest.mark.parametrize("C_x", [0.001, 0.05, 2.0])
def test_trim_balances_gravity_and_drag_everywhere(theta, C_x):
    point = gb.modeling.linearize(NonlinearTilt(), {"C_x": C_x}, at={"theta": theta}).point
    v = np.sign(theta) * np.sqrt(PAPER_G * np.tan(abs(theta)) / C_x)
    assert_allclose(point["v"], v, rtol=1e-6)
    assert_allclose(point["u"], 5.0 * v / 250.0, rtol=1e-6)


@pytest.mark.parametrize("name", ["v", "u", "rotor"])
def test_the_point_may_be_given_by_any_of_its_coordinates(name):
    """At 5 m/s the drag is 0.05 · 25 m/s², so the angle is arctan(1.25 / g); the control is 5 · 5 / 250."""
    wanted = {"v": 5.0, "q": 0.0, "theta": np.arctan(1.25 / PAPER_G), "rotor": 0.1, "u": 0.1}
    point = gb.modeling.linearize(NonlinearTilt(), at={name: wanted[name]}).point
    assert_allclose([point[n] for n in wanted], list(wanted.values()), rtol=1e-8, atol=1e-12)


# --- which point


def make(derivative, inputs=("u",), states=("x",), **body):
    functions = {
        "derivative": lambda self, x, u, p: derivative(x, u, p),
        "output": lambda self, x, u, p: (x[states[0]],),
        "c": gb.Parameter(4.0, bounds=(-9, 9)),
    }
    return type(
        "Mine", (gb.StateSpace,), {"states": states, "inputs": inputs, **functions, **body}
    )()


def point(model, values=None, **at):
    return gb.modeling.linearize(model, values, at).point


def test_the_whole_point_may_be_given():
    class Level(gb.StateSpace):
        states, inputs, outputs = ("h",), ("u",), ("h",)
        k = gb.Parameter(2.0, bounds=(0.1, 5))

        def derivative(self, x, u, p):
            return (u.u - p.k * x.h**2,)

        def output(self, x, u, p):
            return (x.h,)

    system = gb.modeling.linearize(Level(), {"k": 2.0}, at={"h": 1.0, "u": 2.0})
    assert_allclose(system.A, [[-4.0]])


def test_the_origin_is_taken_where_it_is_an_equilibrium():
    assert point(make(lambda x, u, p: (u.u - p.c * x.x**3,))) == {"x": 0.0, "u": 0.0}


def test_a_state_that_no_derivative_reads_stays_where_it_is_given():
    assert point(YawStates(), psi=0.5) == {"nu": 0.0, "r": 0.0, "rotor": 0.0, "psi": 0.5, "u": 0.0}
    clock = make(lambda x, u, p: (u.u - p.c * x.x, 1 - x.x), states=("x", "psi"))
    assert_allclose(list(point(clock, psi=2.0).values()), [1, 2, 4], rtol=1e-12)


@pytest.mark.parametrize("rate", [1.0, 1e-4])
def test_equations_that_repeat_one_another_are_allowed(rate):
    twin = make(
        lambda x, u, p: (rate * (u.u - p.c * x.x), 2 * rate * (u.u - p.c * x.x)),
        states=("x", "copy"),
    )
    assert_allclose(list(point(twin, u=8.0).values()), [2, 0, 8], rtol=1e-12)
    assert_allclose(list(point(twin, {"c": 2.0}, u=8.0).values()), [4, 0, 8], rtol=1e-12)


def test_the_point_follows_the_parameters_from_the_same_root():
    root = make(lambda x, u, p: (p.c - x.x**2 + u.u,))
    function = trim_of(root, {"u": 0.0}).closed()
    start = float(function(4.0)[0])
    assert abs(start) == pytest.approx(2.0, rel=1e-10)
    assert float(function(9.0)[0]) == pytest.approx(1.5 * start, rel=1e-10)


def test_a_point_that_one_step_does_not_reach_is_reached_in_ten():
    """Newton's method finds the root of an arctangent from no farther than 1.39; at the start it is 4."""
    model = make(lambda x, u, p: (gb.arctan2(x.x - p.c, 1.0) + u.u,))
    function = trim_of(model, {"u": 0.0}).closed()
    for c in (4.5, 9.0, -8.0):
        assert float(function(c)[0]) == pytest.approx(c, rel=1e-9)


@pytest.mark.parametrize(("at", "wanted"), [({}, [0, 0, 0, 0]), ({"Omega_2": 7.0}, [0, 7, 0, 0])])
def test_a_static_model_is_where_its_inputs_are_given(at, wanted):
    assert list(gb.modeling.linearize(Torques(), at=at).point.values()) == wanted


@pytest.mark.parametrize(
    ("model", "at", "sentence"),
    [
        (
            NonlinearTilt(),
            {"speed": 1},
            r"NonlinearTilt has no state or input 'speed'; it has v, q, theta, rotor, u",
        ),
        (NonlinearTilt(), {"theta": np.nan}, r"at\['theta'\] is nan: give a finite number"),
        (NonlinearTilt(), {"theta": "5"}, r"at\['theta'\] is .*5.*: give a finite number"),
        (
            NonlinearTilt(),
            {"theta": 0.1, "v": 0.0},
            r"NonlinearTilt has no operating point with .* check `at`",
        ),
        (NonlinearTilt(), {"q": 0.1}, r"NonlinearTilt has no operating point with \{'q': 0\.1\}"),
        (YawStates(), {"u": 0.1}, r"YawStates has no operating point"),
        (Torques(), {"Omega_5": 1.0}, r"Torques has no state or input 'Omega_5'; it has Omega_1"),
        (
            make(lambda x, u, p: (u.a + u.b - p.c * x.x + 1,), inputs=("a", "b")),
            {},
            r"point of Mine is not determined by at=\{\}: give 2 more of x, a, b",
        ),
        (
            make(lambda x, u, p: (u.a + u.b - p.c * x.x + 1,), inputs=("a", "b")),
            {"a": 3.0},
            r"not determined by at=\{'a': 3\.0\}: give 1 more of x, b",
        ),
        (
            make(lambda x, u, p: (u.u - (x.x - 1) ** 2,)),
            {"u": 0.0},
            r"Mine at \{'u': 0\.0\} has a singular operating point .* declare trim",
        ),
    ],
)
def test_what_is_no_operating_point_is_refused(model, at, sentence):
    with pytest.raises(ValueError, match=sentence):
        gb.modeling.linearize(model, at=at)


def test_values_without_an_operating_point_are_said_and_print_nothing(capfd):
    """At c = -1 the equation x² = c has no root: an optimizer meets infinity or NaN, a person a sentence."""
    root = make(lambda x, u, p: (p.c - x.x**2 + u.u,))
    assert not np.all(np.isfinite(np.asarray(trim_of(root, {"u": 0.0}).closed()(-1.0)[0])))
    with pytest.raises(ValueError, match="no operating point"):
        gb.modeling.linearize(root, {"c": -1.0}, {"u": 0.0})
    with pytest.raises(ValueError, match="no operating point"):
        gb.frequency_response(root, {"c": -1.0}, OMEGA, at={"u": 0.0})
    printed = capfd.readouterr()
    assert (printed.out, printed.err) == ("", "")


# --- the model's own trim


def test_the_own_trim_is_the_implicit_one():
    for theta in (0.0, 0.0873, -0.0873):
        own, implicit = (point(model, theta=theta) for model in (OwnTrim(), NonlinearTilt()))
        assert_allclose(list(own.values()), list(implicit.values()), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("trim", "sentence"),
    [
        (
            lambda self, at, p: {"x": 1.0},
            r"Mine\.trim at \{'u': 2\.0\} is not an equilibrium: .* 'x' is -2 there",
        ),
        (
            lambda self, at, p: {"x": at.u / p.c, "y": 0.0},
            r"Mine has no state or input 'y'; it has x, u",
        ),
        (lambda self, at, p: {"x": np.nan}, r"Mine\.trim becomes NaN"),
        (lambda self, at, p: {"x": at.w}, r"at has no 'w'; it has u"),
        (lambda self, at, p: 3.0, r"Mine\.trim returns 3\.0: return the other states"),
    ],
)
def test_a_wrong_own_trim_is_refused(trim, sentence):
    model = make(lambda x, u, p: (u.u - p.c * x.x,), trim=trim)
    with pytest.raises((ValueError, AttributeError), match=sentence):
        gb.modeling.linearize(model, at={"u": 2.0})


def test_what_is_given_wins_over_the_own_trim():
    model = make(
        lambda x, u, p: (u.u - p.c * x.x,), trim=lambda self, at, p: {"u": p.c * at.x, "x": 99.0}
    )
    assert point(model, {"c": 2.0}, x=3.0) == {"x": 3.0, "u": 6.0}


def test_an_own_trim_is_judged_relative_to_its_size():
    """Rounding of a level of 1e7 is no mistake; the same at a level of 1 is."""

    def trimmed(level):
        return make(
            lambda x, u, p: (u.u - x.x,),
            trim=lambda self, at, p: {"x": at.u * (1 + 1e-8) + 1e-3 * level},
        )

    assert gb.modeling.linearize(trimmed(0), at={"u": 1e7}).point["x"] == pytest.approx(
        1e7, rel=1e-7
    )
    for sign in (1, -1):
        with pytest.raises(ValueError, match="is not an equilibrium"):
            gb.modeling.linearize(trimmed(sign), at={"u": 1.0})


def test_the_state_that_moves_most_at_a_wrong_trim_is_named():
    class Two(gb.StateSpace):
        states, inputs, outputs = ("x", "y"), ("u",), ("x",)
        c = gb.Parameter(1.0)

        def derivative(self, x, u, p):
            return (u.u - p.c * x.x, 1 - x.y)

        def output(self, x, u, p):
            return (x.x,)

        def trim(self, at, p):
            return {"x": 9.0, "y": 0.0}

    with pytest.raises(ValueError, match=r"the derivative of 'x' is -7 there"):
        gb.modeling.linearize(Two(), at={"u": 2.0})
