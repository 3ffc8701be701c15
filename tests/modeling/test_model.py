"""Declarations: what they collect, what they refuse, and parameters that are one unknown."""

import copy
import pickle

import numpy as np
import pytest
from gain_and_lag import Gain, Lag

import greybox as gb
from greybox.modeling.formula_arguments import Names
from greybox.modeling.merged_parameters import merge, merged_parameters
from greybox.modeling.model import equation, pick_signals
from greybox.models.polynomial import Polynomial
from greybox.models.rotor import Rotor
from greybox.models.tilt import LinearTilt, Tilt
from greybox.models.yaw import YawAngle, YawRate

OMEGA = np.geomspace(0.3, 40, 12)


def test_names_are_attributes_and_mapping():
    names = Names({"a": 1.0, "b": 2.0})
    assert (names.a, names["b"], names.get("c", 3.0)) == (1.0, 2.0, 3.0)
    assert dict(names) == {**names} == {"a": 1.0, "b": 2.0}
    assert (len(names), list(names), "a" in names, "c" in names) == (2, ["a", "b"], True, False)
    assert repr(names) == "Names({'a': 1.0, 'b': 2.0})"


def test_names_say_what_there_is():
    with pytest.raises(
        AttributeError, match=r"Tilt has no 'a6'; it has a1, a2, a3, a4, T_rotor, T_delay, a5\."
    ):
        _ = Tilt().values().a6
    with pytest.raises(AttributeError, match="it has no 'a'; it has none"):
        _ = Names({}).a
    with pytest.raises(KeyError, match="a6"):
        Tilt().values()["a6"]


def test_names_are_read_only():
    with pytest.raises(AttributeError, match="'a1' cannot be set: these values are read-only"):
        Tilt().values().a1 = 3.0


@pytest.mark.parametrize("name", ["keys", "values", "label", "derived", "response"])
def test_a_parameter_may_not_hide_what_a_formula_or_the_framework_calls(name):
    """As a parameter, `values` would replace the method of that name."""
    with pytest.raises(ValueError, match=f"Broken .*{name!r}.*another name"):
        type("Broken", (gb.TransferFunction,), {name: gb.Parameter(1.0)})


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


@pytest.mark.parametrize(
    "model", [Tilt(), LinearTilt(), Polynomial(3, m=2), Lag() * Tilt()], ids=repr
)
def test_models_can_be_sent_to_another_process(model):
    copy = pickle.loads(pickle.dumps(model))
    assert repr(copy) == repr(model)
    assert dict(copy.parameters) == dict(model.parameters)


def test_a_declaration_without_a_formula_cannot_be_used():
    with pytest.raises(TypeError, match="response"):
        type("Empty", (gb.TransferFunction,), {})()
    with pytest.raises(TypeError, match="output"):
        type("Empty", (gb.StateSpace,), {})()


def test_a_formula_that_is_missing_is_named():
    with pytest.raises(TypeError, match=r"Empty has no formula response\(self, s, p\): declare it"):
        type("Empty", (gb.TransferFunction,), {})()
    with pytest.raises(
        TypeError, match=r"Empty has no formula output\(self, x, u, p\): declare it"
    ):
        type("Empty", (gb.StateSpace,), {})()


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
            r"bounds of 'T', \(0, 1\) and \(2, 3\), do not overlap",
        ),
        (
            {"bounds": (0, 1)},
            {"bounds": (1, 3)},
            r"bounds of 'T', \(0, 1\) and \(1, 3\), do not overlap",
        ),
        (
            {"starts": (0, 1)},
            {"starts": (2, 3)},
            r"start boxes of 'T', \(0, 1\) and \(2, 3\), do not overlap",
        ),
    ],
)
def test_parameters_that_cannot_be_one_unknown_are_refused(a, b, sentence):
    first, second = (gb.Parameter(**{"start": 1.0} | words) for words in (a, b))
    with pytest.raises(ValueError, match=sentence):
        merge("T", first, second)


def test_a_fixed_and_a_free_rotor_do_not_connect():
    with pytest.raises(ValueError, match="'T_rotor' is fixed in one part and free in the other"):
        Rotor().series(Tilt(), shared=["T_rotor", "T_delay"])
    assert list(merged_parameters([YawRate(), YawAngle()])) == list(YawRate().parameters)


@pytest.mark.parametrize("value", [0.5, None])
def test_a_value_in_the_place_of_a_declared_parameter_is_refused(value):
    class Lag(gb.TransferFunction):
        tau = gb.Parameter(0.1, bounds=(0.01, 1))

        def response(self, s, p):
            return 1 / (p.tau * s + 1)

    with pytest.raises(TypeError, match=rf"Slow\.tau is {value} where a Parameter was declared"):
        type("Slow", (Lag,), {"tau": value})


@pytest.mark.parametrize(
    ("base", "name", "value", "words"),
    [
        (gb.StateSpace, "algebraic", ("z",), "has no effect"),
        (gb.StateSpace, "parameters", {"a": 1.0}, r"has no effect.*a1 = gb\.Parameter"),
        (gb.StateSpace, "state", ("x",), "has no effect: did you mean 'states'"),
        (gb.StateSpace, "input", "u", "has no effect: did you mean 'inputs'"),
        (gb.StateSpace, "delay", {"u": "T"}, "has no effect: did you mean 'delays'"),
        (gb.StateSpace, "unit", {"y": "m"}, "has no effect: did you mean 'units'"),
        (gb.TransferFunction, "outputs", ("y",), "has no effect: did you mean 'output'"),
        (gb.TransferFunction, "delays", {"u": "T"}, r"has no effect: multiply .* gb\.exp"),
        (gb.TransferFunction, "Derived", {"a": len}, "has no effect: did you mean 'derived'"),
        (gb.StateSpace, "state_start", {"x": 1.0}, "has no effect: did you mean 'state_starts'"),
        (gb.StateSpace, "events", {"x": 1.0}, r"has no effect: split .* gb\.several"),
        (gb.StateSpace, "jumps", lambda self, x, u, p: x, r"has no effect: .* gb\.several"),
        (gb.StateSpace, "x0", (1.0,), "has no effect: give initial="),
        (gb.StateSpace, "process_noise", {"x": 1.0}, "has no effect: .* to the criterion"),
        (gb.TransferFunction, "bounds", {"K": (0, 1)}, r"has no effect: .*gb\.Parameter"),
        (gb.TransferFunction, "constraints", (abs,), "has no effect: .* to the problem"),
        (gb.StateSpace, "derivatives", lambda self, x, u, p: (), "has no effect: did you mean"),
        (gb.StateSpace, "output", None, "is None: give a function"),
        (gb.StateSpace, "states", "x", "is 'x': give a tuple of names"),
        (gb.StateSpace, "delays", ("u",), r"is \('u',\): give a dictionary"),
        (gb.TransferFunction, "output", ("y",), r"is \('y',\): give a name"),
        (gb.TransferFunction, "response", None, "is None: give a function"),
    ],
)
def test_attributes_that_cannot_have_the_effect_of_their_name_are_refused(base, name, value, words):
    with pytest.raises(TypeError, match=rf"Own\.{name} {words}"):
        type("Own", (base,), {name: value})


def test_other_attributes_are_a_users_own():
    own = {"delay": 0.02, "input2": "w", "state_names_in_log": ("x",), "united": True, "notes": ""}
    assert type("Own", (gb.TransferFunction,), own).delay == 0.02
    delayed = type("Own", (gb.TransferFunction,), {"delays": gb.Parameter(0.02)})
    assert [*delayed.parameters] == ["delays"]


def test_constants_tables_and_helpers_of_formulas_are_a_users_own():
    class Own(gb.TransferFunction):
        """A gain from a table, by constants and a helper whose names could be mistaken."""

        MASS = 1.2
        events = (2.0, 3.0)
        noise = 0.1
        TABLE = {"a": 1.0}
        K = gb.Parameter(1.0)

        def responses(self, s):
            return self.MASS * self.events[1] * self.TABLE["a"] / s

        def response(self, s, p):
            return p.K * self.responses(s)

    answer = gb.frequency_response(Own(), {"K": 2.0}, omega=[0.5])
    assert abs(answer.response[0]) == pytest.approx(2.0 * 1.2 * 3.0 / 0.5)


def test_signals_are_picked_by_name_or_because_they_are_the_only_ones():
    assert pick_signals(LinearTilt(), output="v") == ("u", "v")
    assert pick_signals(Tilt()) == ("u", "theta")
    assert pick_signals(Tilt(), "u", "theta") == ("u", "theta")
    with pytest.raises(
        ValueError, match=r"LinearTilt has several outputs \(theta, v\): specify which one, output="
    ):
        pick_signals(LinearTilt())
    with pytest.raises(ValueError, match=r"Tilt has no input 'v'; it has u\."):
        pick_signals(Tilt(), "v")


def test_values_are_given_to_a_problem_not_to_a_model():
    for args, kwargs in (((1.0,), {}), ((), {"k": 1.0})):
        with pytest.raises(
            TypeError, match=r"Lag\(\) takes no arguments: give values to a problem"
        ):
            Lag(*args, **kwargs)
    with pytest.raises(
        TypeError, match=r"the argument of Lag is \[1\]: give \{name: value\}, after the model"
    ):
        Lag().values([1])
    for value in ("1", None, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"k = .* of Lag is not a finite number: give one"):
            Lag().values({"k": value})


def test_names_can_be_copied():
    names = Names({"a": 1.0, "b": 2.0})
    for copied in (copy.copy(names), pickle.loads(pickle.dumps(names))):
        assert dict(copied) == {"a": 1.0, "b": 2.0}
    assert not hasattr(names, "__array__")


def test_a_merged_start_box_stays_within_the_merged_bounds():
    a = gb.Parameter(5.0, bounds=(0, 10), starts=(1, 9))
    b = gb.Parameter(5.0, bounds=(3, 6))
    merged = merge("T", a, b)
    assert (merged.bounds, merged.starts, merged.start) == ((3, 6), (3, 6), 5.0)
    inside = merge("T", gb.Parameter(5.0, bounds=(0, 10), starts=(4, 5)), b)
    assert inside.starts == (4, 5)
    assert merge("T", gb.Parameter(8.0, bounds=(0, 10)), b).start == 6
