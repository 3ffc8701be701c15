"""Formulas in MathML: well formed, and in the order in which they are read."""

import pytest

import greybox as gb
from greybox.html_report.elements import html, tag
from greybox.html_report.equation import equations
from greybox.html_report.mathml import parenthesized, symbol, written
from greybox.modeling.expression_tree import Function, Symbol, Term, factor, number, power
from greybox.models.drag import Drag
from greybox.models.rate import DampedAngle
from greybox.models.tilt import LinearTilt


def read(element):
    return "".join(element.itertext())


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("omega_p", "ωp"),
        ("a1", "a1"),
        ("T_rotor", "Trotor"),
        ("K_Omega", "KΩ"),
        ("tau", "τ"),
        ("_", "_"),
    ],
)
def test_names_are_symbols_with_indices(name, text):
    assert read(symbol(name)) == text
    assert (symbol(name).tag == "msub") == (len(text) > 1 and name != "tau")


def test_a_transfer_function_is_a_fraction_with_its_delay():
    (equation,) = equations(DampedAngle())
    assert equation.tag == "math"
    fraction, delay = equation.find("mrow").findall(".//mfrac")[1], equation.findall(".//msup")[-1]
    assert [read(part) for part in fraction] == ["Kφ", "s(s+a)(Trotors+1)"]
    assert read(delay) == "e−sTdelay"


def test_an_ode_has_a_line_for_each_state_and_its_delayed_input():
    lines = [read(equation) for equation in equations(LinearTilt())]
    assert lines[0] == "v˙=9.8065θ−a5v"
    assert lines[3] == "rotor˙=u(t−Tdelay)−rotorTrotor"
    assert len(lines) == 4  # the outputs are states


def test_with_values_numbers_stand_in_the_place_of_names():
    (equation,) = equations(Drag(), {"a5": 0.25, "C_x": 1e-6})
    assert read(equation) == "v˙=9.8065tan(θ)−0.25v−1·10−6|v|v"


def test_a_formula_too_long_to_be_read_is_refused():
    class Long(gb.TransferFunction):
        K = gb.Parameter(1.0)

        def response(self, s, p):
            for _ in range(20):
                s = s * gb.exp(s) + p.K
            return s

    with pytest.raises(ValueError, match="too long to read"):
        equations(Long())


def test_elements_escape_what_they_hold():
    made = tag("p", "<b>&", tag("i", "x"), "tail </p>", title='"><script>', hidden=True, lang=None)
    assert (
        html(made)
        == '<p title="&quot;&gt;<script&gt;" hidden="">&lt;b&gt;&amp;<i>x</i>tail &lt;/p&gt;</p>'
    )
    assert html(tag("p", "\x1b[2J\ud800")) == "<p>\\x1b[2J\\ud800</p>"


A, B, T = Symbol("a"), Symbol("b"), Symbol("tau")
DIFFERENCE = (Term(-1, (A,)), Term(1, (B,)))
GROUP = Function("()", (DIFFERENCE,))
ABOVE = Function("<", (factor(A), factor(B)))
(E_TO_B,) = power(factor(Symbol("e")), factor(B))[0].over


@pytest.mark.parametrize(
    ("expression", "text"),
    [
        (number(1 / 3), "0.33333"),
        (number(-1.5e-7), "−1.5·10−7"),
        (number(2e9), "2·109"),
        (number(0.0), "0"),
        (number(float("inf")), "∞"),
        (number(float("nan")), "?"),
        (DIFFERENCE, "−a+b"),
        ((Term(1, (A,)), Term(-1, (B,)), Term(1, (ABOVE,))), "a−b+(a<b)"),
        ((Term(2.0, (A, GROUP)),), "2a(−a+b)"),
        ((Term(2.0, (ABOVE,)),), "2(a<b)"),
        ((Term(1, (A, E_TO_B), (T,)),), "aτeb"),
        ((Term(1, (E_TO_B,), (T,)),), "1τeb"),
        ((Term(1, power(factor(A), number(2.0))[0].over, (T,)),), "a2τ"),
        (power(factor(Symbol("u", "tau")), number(2.0)), "(u(t−τ))2"),
        (power(number(10.0), factor(A)), "10a"),
        (power(DIFFERENCE, number(3.0)), "(−a+b)3"),
        (factor(Function("abs", (factor(A),))), "|a|"),
        (factor(Function("if", (factor(ABOVE), DIFFERENCE))), "[a<b](−a+b)"),
        (factor(Function("if", (factor(ABOVE), factor(T)))), "[a<b]τ"),
        (factor(Function("≤", (factor(B), factor(A)))), "b≤a"),
        (factor(Function("arctan2", (factor(A), DIFFERENCE, factor(B)))), "arctan2(a,−a+b,b)"),
        (factor(Symbol("u", "T_delay")), "u(t−Tdelay)"),
    ],
)
def test_every_kind_of_expression_is_written_as_on_paper(expression, text):
    assert read(written(expression)) == text


def test_roots_powers_and_fractions_have_their_elements():
    root = written(power(DIFFERENCE, number(0.5)))
    assert (root.tag, read(root)) == ("msqrt", "−a+b")
    raised = written(power(factor(A), factor(B)))
    assert (raised.tag, [read(part) for part in raised]) == ("msup", ["a", "b"])
    row = written((Term(3.0, (A, E_TO_B), (T,)),))
    assert [(part.tag, read(part)) for part in row] == [
        ("mfrac", "3aτ"),
        ("mspace", ""),
        ("msup", "eb"),
    ]
    fraction = row.find("mfrac")
    for inside, stretchy in (
        (fraction, "true"),
        (tag("mrow", fraction), "true"),
        (tag("mi", "x"), "false"),
    ):
        left, *_, right = parenthesized(tag("mi", "y"), inside)
        assert (left.get("stretchy"), right.get("stretchy")) == (stretchy,) * 2
