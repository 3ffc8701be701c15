"""Frequency responses, in numbers and compiled, of small models solved by hand."""

import casadi as ca
import numpy as np
import pytest
from evaluation import compiled_response, response_formula
from numpy.testing import assert_allclose
from two_tanks import AT, Tanks

import greybox as gb
from greybox.modeling.linear_response import response_formulas
from greybox.modeling.model import pick_signals
from greybox.models.multirotor import Torques
from greybox.models.tilt import LinearTilt, NonlinearTilt, Tilt

OMEGA = np.geomspace(0.3, 40, 12)


S = 1j * OMEGA


@pytest.mark.parametrize("k", [1.0, 2.0, 5.0])
@pytest.mark.parametrize(("u", "y"), [(u, y) for u in Tanks.inputs for y in Tanks.outputs])
def test_every_pair_has_its_own_delay_and_feedthrough(k, u, y):
    upper, lower = k**2 / 8, k**2 / 6  # k / (2 sqrt(h)), with k sqrt(h) the flow of 4 and 3
    level = upper / (S + upper) / (S + lower) if u == "inflow" else -1 / (S + lower)
    expected = level if y == "level" else 3 * level - (0.5 if u == "leak" else 0)
    expected = expected * np.exp(-S * (0.3 if u == "inflow" else 0.1))
    options = {"input": u, "output": y, "at": AT}
    values = {"k": k}
    assert_allclose(
        gb.frequency_response(Tanks(), values, OMEGA, **options).response, expected, rtol=1e-9
    )
    assert_allclose(compiled_response(Tanks(), OMEGA, **options)(values), expected, rtol=1e-9)
    form = gb.modeling.rational(Tanks(), values, **options)
    assert_allclose(form(S), expected, rtol=1e-8)
    assert form.delay == (0.3 if u == "inflow" else 0.1)


def test_a_frequency_response_names_its_signals_and_model():
    measured = gb.frequency_response(LinearTilt(), {}, [1.0, 2.0], output="v")
    assert (measured.input, measured.output, measured.name, measured.source) == (
        "u",
        "v",
        "LinearTilt",
        "model",
    )
    assert_allclose(measured.omega, [1, 2])
    assert len(gb.frequency_response(Tilt(), {}, 3.0)) == 1


class Constant(gb.TransferFunction):
    """A gain, which does not depend on s."""

    k = gb.Parameter(2.0)

    def response(self, s, p):
        return p.k


def test_a_constant_response_holds_at_every_frequency():
    assert_allclose(gb.frequency_response(Constant(), {}, OMEGA).response, np.full(12, 2.0))
    assert_allclose(compiled_response(Constant(), OMEGA)({"k": 3.0}), np.full(12, 3.0))
    assert gb.modeling.rational(Constant()).numerator == [2.0]


@pytest.mark.parametrize(("u", "slope"), [("Omega_1", -2e-3), ("Omega_2", 2.4e-3)])
def test_a_static_model_has_a_constant_response(u, slope):
    at = {"Omega_1": 500.0, "Omega_2": 600.0}
    options = {"input": u, "output": "tau_phi", "at": at}
    assert_allclose(
        gb.frequency_response(Torques(), {}, OMEGA, **options).response,
        np.full(12, slope),
        rtol=1e-14,
    )
    assert_allclose(
        compiled_response(Torques(), OMEGA, **options)(), np.full(12, slope), rtol=1e-14
    )
    form = gb.modeling.rational(Torques(), **options)
    assert_allclose((form.numerator, form.denominator), [[slope], [1]], rtol=1e-14)


@pytest.mark.parametrize("word", ["pade", "pade:0", "pade:-1", "pade:100", "PADE:3", "", 3, None])
def test_other_delay_words_are_refused(word):
    with pytest.raises(ValueError, match=r"delay .* is not known: use 'exact' or 'pade:n'"):
        gb.frequency_response(Tilt(), {}, OMEGA, delay=word)


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        ({"output": "w"}, r"LinearTilt has no output 'w'; it has theta, v\."),
        ({"input": "w", "output": "v"}, r"LinearTilt has no input 'w'; it has u"),
        ({}, r"LinearTilt has several outputs \(theta, v\): specify which one, output=\.\.\."),
    ],
)
@pytest.mark.parametrize("read", [gb.frequency_response, response_formula, gb.modeling.rational])
def test_signals_that_are_not_there_are_refused(read, names, sentence):
    arguments = {
        gb.frequency_response: ({}, OMEGA),
        response_formula: (OMEGA,),
        gb.modeling.rational: (),
    }[read]
    with pytest.raises(ValueError, match=sentence):
        read(LinearTilt(), *arguments, **names)


def test_the_only_signals_need_no_name():
    assert pick_signals(Tilt()) == ("u", "theta")
    assert pick_signals(LinearTilt(), output="v") == ("u", "v")


@pytest.mark.parametrize("read", [gb.frequency_response, response_formula])
def test_a_transfer_function_has_no_operating_point(read):
    with pytest.raises(
        ValueError, match=r"Tilt is a transfer function and has no operating point: leave out at"
    ):
        read(Tilt(), *([{}] if read is gb.frequency_response else []), OMEGA, at={"theta": 0.1})
    with pytest.raises(ValueError, match=r"Tilt is a transfer function and has no operating point"):
        gb.modeling.rational(Tilt(), at={"theta": 0.1})


def test_a_pole_on_the_imaginary_axis_is_said():
    """An undamped oscillator of 2 rad/s, asked at 2 rad/s."""
    values = {"a1": 4.0, "a2": 0.0, "a3": 0.0, "a5": 1.0}
    with pytest.raises(ValueError, match="pole"):
        gb.frequency_response(LinearTilt(), values, [1.0, 2.0], output="theta")


def state_space(derivative=lambda x, u, p: (u.u - p.c * x.x,), output=lambda x, u, p: (x.x,)):
    body = {
        "states": ("x",),
        "c": gb.Parameter(1.0, bounds=(0.1, 5)),
        "derivative": lambda self, x, u, p: derivative(x, u, p),
        "output": lambda self, x, u, p: output(x, u, p),
    }
    return type("Mine", (gb.StateSpace,), body)()


def test_a_single_derivative_or_output_needs_no_tuple():
    one = state_space(lambda x, u, p: u.u - p.c * x.x, lambda x, u, p: x.x)
    assert_allclose(gb.frequency_response(one, {}, OMEGA).response, 1 / (S + 1), rtol=1e-12)


def transfer_function(formula):
    body = {"c": gb.Parameter(1.0), "response": lambda self, s, p: formula(s, p)}
    return type("Mine", (gb.TransferFunction,), body)()


@pytest.mark.parametrize("read", [gb.frequency_response, response_formula])
@pytest.mark.parametrize(
    ("formula", "sentence"),
    [
        (
            lambda s, p: np.ones(2),
            r"Mine\.response returns 2 values for 12 frequencies: return one for each",
        ),
        (lambda s, p: None, r"Mine\.response returns a NoneType"),
        (lambda s, p: "text", r"Mine\.response returns"),
    ],
)
def test_wrong_responses_are_said_in_a_sentence(read, formula, sentence):
    with pytest.raises(ValueError, match=sentence):
        read(transfer_function(formula), *([{}] if read is gb.frequency_response else []), OMEGA)


def test_compiled_responses_have_exact_derivatives():
    """Of 1 / (s + c) with respect to c: -1 / (s + c)² and 2 / (s + c)³."""
    function = response_formula(state_space(), OMEGA).closed()
    p = ca.MX.sym("p", 1)
    first = [ca.jacobian(part, p) for part in function(p)]
    second = [ca.jacobian(part, p) for part in first]
    numbers = [np.asarray(v).ravel() for v in ca.Function("d", [p], [*first, *second])(1.5)]
    assert_allclose(numbers[0] + 1j * numbers[1], -1 / (S + 1.5) ** 2, rtol=1e-12)
    assert_allclose(numbers[2] + 1j * numbers[3], 2 / (S + 1.5) ** 3, rtol=1e-12)


def test_elimination_needs_no_pivoting_for_a_chain_through_zero_diagonals():
    """The double integrator of `NonlinearTilt` without stiffness: every pivot holds s."""
    values = {"a1": 0.0, "a2": 0.0, "a3": 0.0}
    got = compiled_response(NonlinearTilt(), OMEGA, output="theta")(values)
    p = NonlinearTilt().values(values)
    assert_allclose(got, p.a4 / S**2 / (p.T_rotor * S + 1) * np.exp(-S * p.T_delay), rtol=1e-12)


def test_values_at_which_the_matrices_are_not_finite_leave_the_order_of_elimination():
    """Draws of c are below zero, where its root is no number; the response at c = 4 is that of the two equations."""

    class Rooted(gb.StateSpace):
        states, inputs, outputs = ("x", "y"), ("u",), ("y",)
        c = gb.Parameter(4.0, bounds=(-1e6, 5))

        def derivative(self, x, u, p):
            return (x.y + 0 * x.x, -gb.sqrt(p.c) * x.x - x.y + u.u)

        def output(self, x, u, p):
            return (x.y,)

    expected = S / (S**2 + S + 2)
    assert_allclose(
        gb.frequency_response(Rooted(), {}, OMEGA, at={"u": 0.0}).response, expected, rtol=1e-9
    )
    assert_allclose(
        compiled_response(Rooted(), OMEGA, at={"u": 0.0})({"c": 4.0}), expected, rtol=1e-9
    )


def test_responses_that_share_an_elimination_are_those_of_numpy():
    random = np.random.default_rng(0)
    A, B, C, D = (random.normal(size=size) for size in ((4, 4), (4, 3), (2, 4), (2, 3)))

    class System(gb.StateSpace):
        states, inputs, outputs = tuple("abcd"), ("u", "v", "w"), ("y", "z")
        delays = {"v": "tau"}
        k = gb.Parameter(1.5, bounds=(0, 3))
        tau = gb.Parameter(0.1, bounds=(0, 1))

        def derivative(self, x, u, p):
            x, u = [*x_values(x, self.states)], [*x_values(u, self.inputs)]
            return [p.k * (row @ x) + b @ u for row, b in zip(A, B, strict=True)]

        def output(self, x, u, p):
            x, u = [*x_values(x, self.states)], [*x_values(u, self.inputs)]
            return [row @ x + d @ u for row, d in zip(C, D, strict=True)]

    def x_values(names, wanted):
        return np.array([names[name] for name in wanted], dtype=object)

    pairs = [("w", "z"), ("v", "y"), ("u", "z")]
    for formula, (u, y) in zip(response_formulas(System(), OMEGA, pairs), pairs, strict=True):
        k, i = System.outputs.index(y), System.inputs.index(u)
        exact = [
            C[k] @ np.linalg.solve(1j * w * np.eye(4) - 1.5 * A, B[:, i]) + D[k, i] for w in OMEGA
        ] * np.exp(-1j * OMEGA * 0.1 * (u == "v"))
        re, im = (np.array(part) for part in formula.closed()([1.5, 0.1]))
        np.testing.assert_allclose((re + 1j * im).ravel(), exact, rtol=1e-9)
