"""Declarations: what they collect, what they refuse, and how transfer functions are connected."""

import pickle

import numpy as np
import pytest
from evaluation import compiled_response
from numpy.testing import assert_allclose

import greybox as gb
from greybox.modeling.model import Names, equation, merge, merged_parameters
from greybox.models.polynomial import Polynomial
from greybox.models.rotor import Rotor
from greybox.models.tilt import LinearTilt, Tilt
from greybox.models.yaw import YawAngle, YawRate

OMEGA = np.geomspace(0.3, 40, 12)


class Gain(gb.TransferFunction):
    r"""A number, (0.0)."""

    k = gb.Parameter(2.0, bounds=(0, 10))

    def response(self, s, p):
        return p.k


class Lag(Gain):
    """A gain with a time constant."""

    T = gb.Parameter(0.5, bounds=(0, 5), unit="s")

    def response(self, s, p):
        return super().response(s, p) / (p.T * s + 1)


def response(model, values=None, **options):
    return gb.frequency_response(model, values, OMEGA, **options).response


# --- names


def test_names_are_attributes_and_mapping():
    names = Names({"a": 1.0, "b": 2.0})
    assert (names.a, names["b"], names.get("c", 3.0)) == (1.0, 2.0, 3.0)
    assert dict(names) == {**names} == {"a": 1.0, "b": 2.0}
    assert (len(names), list(names), "a" in names, "c" in names) == (2, ["a", "b"], True, False)
    assert repr(names) == "Names({'a': 1.0, 'b': 2.0})"


def test_names_say_what_there_is():
    with pytest.raises(AttributeError, match=r"Tilt has no 'a6'; it has a1, a2, a3, a4, T_rotor, T_delay, a5\."):
        _ = Tilt().values().a6
    with pytest.raises(AttributeError, match="it has no 'a'; it has nothing"):
        _ = Names({}).a
    with pytest.raises(KeyError, match="a6"):
        Tilt().values()["a6"]


def test_names_are_read_only():
    with pytest.raises(AttributeError, match="'a1' cannot be set: these values are read-only"):
        Tilt().values().a1 = 3.0


@pytest.mark.parametrize("name", ["keys", "values", "label", "derived"])
def test_a_parameter_may_not_hide_what_a_formula_or_the_framework_calls(name):
    """As a parameter, `values` would replace the method of that name."""
    with pytest.raises(ValueError, match=f"Broken .*{name!r}.*another name"):
        type("Broken", (gb.TransferFunction,), {name: gb.Parameter(1.0)})


@pytest.mark.parametrize("name", ["keys", "values"])
@pytest.mark.parametrize("kind", ["states", "inputs"])
def test_a_signal_may_not_hide_what_the_framework_calls(kind, name):
    with pytest.raises(ValueError, match=f"Broken .*{name!r}.*another name"):
        declare(**{kind: (name,)})


# --- models


def test_parameters_come_in_the_order_of_declaration_parents_first():
    assert list(Lag().parameters) == ["k", "T"]
    with pytest.raises(TypeError):
        Lag.parameters["T"] = Lag.parameters["k"]


def test_values_are_the_starts_unless_given():
    assert dict(Lag().values()) == {"k": 2.0, "T": 0.5}
    assert dict(Lag().values({"T": 1.0}, k=3.0)) == {"k": 3.0, "T": 1.0}
    with pytest.raises(ValueError, match=r"Lag has no parameter 'tau'; it has k, T\."):
        Lag().values(tau=1.0)


def test_a_model_says_its_signals_label_and_arguments():
    assert (Tilt().input_names, Tilt().output_names) == (("u",), ("theta",))
    assert (LinearTilt().input_names, LinearTilt().output_names) == (("u",), ("theta", "v"))
    assert Tilt().label == "Tilt"
    assert repr(Tilt()) == "Tilt()"
    assert repr(Polynomial(3, m=2)) == "Polynomial(3, m=2)"
    assert equation(Gain) == equation(Gain()) == "A number, (0.0)."


@pytest.mark.parametrize("model", [Tilt(), LinearTilt(), Polynomial(3, m=2), Lag() * Tilt()], ids=repr)
def test_models_can_be_sent_to_another_process(model):
    copy = pickle.loads(pickle.dumps(model))
    assert repr(copy) == repr(model)
    assert dict(copy.parameters) == dict(model.parameters)


def declare(**body):
    functions = {"derivative": lambda self, x, u, p: (-x.x,), "output": lambda self, x, u, p: (x.x,)}
    return type("Broken", (gb.StateSpace,), {"states": ("x",), **functions, **body})


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ({"states": "x"}, r"Broken\.states = 'x' must be a tuple of different names"),
        ({"inputs": ("u", "u")}, r"Broken\.inputs = \('u', 'u'\) must be a tuple of different names"),
        ({"outputs": "y"}, r"Broken\.outputs = 'y' must be a tuple"),
        ({"inputs": ("x",)}, r"Broken has 'x' both as state and as input: use two names"),
        ({"delays": {"v": "T"}}, r"Broken\.inputs has no input 'v'; it has u"),
        ({"delays": {"u": "T"}}, r"Broken has no parameter 'T'; it has none"),
    ],
)
def test_a_wrong_declaration_is_refused_when_it_is_made(body, sentence):
    with pytest.raises(ValueError, match=sentence):
        declare(**body)


def test_states_need_a_derivative():
    with pytest.raises(TypeError, match=r"Broken has states but no derivative\(self, x, u, p\): declare it"):
        declare(derivative=gb.StateSpace.derivative)


def test_a_declaration_without_a_formula_cannot_be_used():
    with pytest.raises(TypeError, match="response"):
        type("Empty", (gb.TransferFunction,), {})()
    with pytest.raises(TypeError, match="output"):
        type("Empty", (gb.StateSpace,), {})()


# --- series


def test_series_multiplies_responses_and_merges_parameters():
    chain = Rotor() * FreeYaw()
    assert (chain.input_names, chain.output_names) == (("u",), ("r",))
    assert list(chain.parameters) == ["K_Omega", "T_rotor", "T_delay", "a1_tilde", "a2", "a3_tilde", "a4"]
    assert chain.label == "Rotor * FreeYaw"
    values = chain.values(T_rotor=0.07, T_delay=0.02)
    rotor, yaw = ({n: values[n] for n in part.parameters} for part in (Rotor(), FreeYaw()))
    product = response(Rotor(), rotor) * response(FreeYaw(), yaw)
    assert_allclose(response(chain, values), product, rtol=1e-13)
    assert_allclose(compiled_response(chain, OMEGA)(values), product, rtol=1e-12)
    form = gb.modeling.rational(chain, values)
    assert_allclose(form(1j * OMEGA), product, rtol=1e-10)
    assert form.delay == 0.04


class FreeYaw(YawRate):
    """The yaw rate with its rotor free, as that of `Rotor`."""

    T_rotor, T_delay = Rotor.T_rotor, Rotor.T_delay


def test_series_keeps_derived_quantities_of_both():
    assert list((Lag() * Tilt()).derived) == ["a3_tilde"]
    assert list((Tilt() * Lag()).derived) == ["a3_tilde"]


def test_series_of_three():
    chain = Lag() * Tilt() * Gain()
    expected = response(Lag()) * response(Tilt()) * 2.0
    assert_allclose(response(chain), expected, rtol=1e-13)


def test_only_transfer_functions_are_connected():
    with pytest.raises(TypeError):
        Tilt() * LinearTilt()
    with pytest.raises(TypeError, match=r"LinearTilt\(\) is not a TransferFunction"):
        gb.feedback(LinearTilt())
    with pytest.raises(TypeError, match=r"3 is not a TransferFunction"):
        gb.feedback(Tilt(), 3)


# --- feedback


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("back", [None, Lag()], ids=repr)
def test_a_loop_around_a_delay_is_exact_in_numbers_and_casadi(back, sign):
    loop = gb.feedback(Tilt(), back, sign)
    forward = response(Tilt())
    expected = forward / (1 - sign * forward * (1 if back is None else response(back)))
    assert_allclose(response(loop), expected, rtol=1e-12)
    assert_allclose(compiled_response(loop, OMEGA)(), expected, rtol=1e-11)


def test_a_loop_around_a_delay_is_rational_only_with_pade():
    loop = gb.feedback(Tilt(), Lag())
    with pytest.raises(ValueError, match="Padé approximation"):
        gb.modeling.rational(loop)
    form = gb.modeling.rational(loop, pade=3)
    assert form.delay == 0
    assert_allclose(form(1j * OMEGA), response(loop, delay="pade:3"), rtol=1e-9)
    assert_allclose(form(1j * OMEGA), response(loop), rtol=1e-6)


def test_a_loop_without_a_delay_is_rational():
    form = gb.modeling.rational(gb.feedback(Lag()))
    assert_allclose(form(1j * OMEGA), 2 / (0.5j * OMEGA + 3), rtol=1e-13)
    assert len(form.denominator) == 2


def test_a_loop_says_what_is_in_it():
    loop = gb.feedback(Tilt(), Lag())
    assert loop.label == "Feedback(Tilt, Lag)"
    assert gb.feedback(Tilt()).label == "Feedback(Tilt)"
    assert list(loop.parameters) == ["a1", "a2", "a3", "a4", "T_rotor", "T_delay", "a5", "k", "T"]
    assert list(loop.derived) == ["a3_tilde"]
    assert (loop.input, loop.output) == ("u", "theta")


def test_a_loop_has_one_of_two_signs():
    with pytest.raises(ValueError, match=r"sign 0 must be -1 \(negative feedback\) or 1"):
        gb.feedback(Tilt(), sign=0)


# --- merging


def test_merged_bounds_and_start_boxes_intersect():
    a = gb.Parameter(1.0, bounds=(0, 5), unit="s", starts=(0, 4))
    b = gb.Parameter(4.0, bounds=(2, 9), unit="s")
    merged = merge("T", a, b)
    assert (merged.start, merged.bounds, merged.starts) == (2.0, (2, 5), (2, 4))
    assert merge("T", b, gb.Parameter(4.0, bounds=(2, 8), unit="s")).starts is None
    assert merge("T", a, a) is a


@pytest.mark.parametrize(
    ("a", "b", "sentence"),
    [
        (
            {"unit": "s"},
            {"unit": "1/s"},
            r"'T' has the unit 's' in one part and '1/s' in the other: .*rename",
        ),
        ({"fixed": True}, {}, r"'T' is fixed in one part and free in the other: .*rename=\{'T'"),
        (
            {"fixed": True},
            {"fixed": True, "start": 2.0},
            r"'T' is fixed at 1 in one part and at 2 in the other",
        ),
        (
            {"bounds": (0, 1)},
            {"bounds": (2, 3), "start": 2.0},
            r"bounds of 'T', \(0, 1\) and \(2, 3\), do not meet",
        ),
        ({"bounds": (0, 1)}, {"bounds": (1, 3)}, r"bounds of 'T', \(0, 1\) and \(1, 3\), do not meet"),
        ({"starts": (0, 1)}, {"starts": (2, 3)}, r"start boxes of 'T', \(0, 1\) and \(2, 3\), do not meet"),
    ],
)
def test_parameters_that_cannot_be_one_unknown_are_refused(a, b, sentence):
    first, second = (gb.Parameter(**{"start": 1.0} | words) for words in (a, b))
    with pytest.raises(ValueError, match=sentence):
        merge("T", first, second)


def test_a_fixed_and_a_free_rotor_do_not_connect():
    with pytest.raises(ValueError, match="'T_rotor' is fixed in one part and free in the other"):
        Rotor() * Tilt()
    assert list(merged_parameters([YawRate(), YawAngle()])) == list(YawRate().parameters)


def test_a_number_in_the_place_of_a_declared_parameter_is_refused():
    class Lag(gb.TransferFunction):
        tau = gb.Parameter(0.1, bounds=(0.01, 1))

        def response(self, s, p):
            return 1 / (p.tau * s + 1)

    with pytest.raises(TypeError, match=r"Slow\.tau is a number where a Parameter was declared"):
        type("Slow", (Lag,), {"tau": 0.5})
