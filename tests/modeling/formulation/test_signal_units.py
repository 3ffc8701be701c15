"""Records in other units than the model declares are refused before a fit, with the sentence that converts them."""

import numpy as np
import pytest

import greybox as gb
from greybox.modeling.formulation.signal_units import as_the_only_pair, check_response_units
from greybox.models.tilt import NonlinearTilt


class Rate(gb.StateSpace):
    """A lag from a servo angle to a rate and a temperature."""

    states, inputs, outputs = ("q",), ("delta",), ("q", "T")
    units = {"delta": "rad", "q": "rad/s", "T": "K"}
    a = gb.Parameter(3.0, bounds=(0.1, 20))

    def derivative(self, x, u, p):
        return (p.a * (u.delta - x.q),)

    def output(self, x, u, p):
        return (x.q, 300 + 0 * x.q)


def record(factor=1.0, **units):
    n = 200
    delta = np.repeat(np.random.default_rng(0).normal(size=n // 10), 10)
    flown = gb.simulate(
        Rate(), {"a": 3.0}, gb.Record(0.05 * np.arange(n), {"delta": delta}), inputs="held"
    )["q"]
    signals = {
        "delta": delta,
        "q": factor * flown,
        "T": 300 + 0.1 * np.random.default_rng(1).normal(size=n),
    }
    return gb.Record(0.05 * np.arange(n), signals, units=units, name="flight")


@pytest.mark.parametrize(
    ("units", "words"),
    [
        (
            {"q": "deg/s"},
            "q is in deg/s in the record 'flight' and in rad/s in Rate: use SI units in both, record = record.in_si()",
        ),
        (
            {"delta": "deg"},
            "delta is in deg in the record 'flight' and in rad in Rate: use SI units in both, record = record.in_si()",
        ),
        ({"q": "mrad/s"}, "q=0.001 * record['q']"),
        ({"T": "degC"}, "T=1 * record['T'] + 273.15"),
        (
            {"q": "m/s"},
            "q is in m/s in the record 'flight' and in rad/s in Rate: these are different quantities",
        ),
        (
            {"q": "rads/s"},
            "q in the record 'flight': the unit 'rads/s' is not known: write 'rad/s' if that is meant.",
        ),
    ],
)
def test_another_unit_is_refused_with_the_cure(units, words):
    with pytest.raises(ValueError, match=r"^[^\n]+\.$") as refused:
        gb.Problem(Rate(), record(**units))
    assert words in str(refused.value)


def test_the_cure_works():
    degrees = record(np.degrees(1.0), q="deg/s")
    with pytest.raises(ValueError, match="convert the record") as refused:
        gb.Problem(Rate(), degrees)
    cure = str(refused.value).partition("convert the record, ")[2].removesuffix(".")
    pasted = {"record": degrees}
    exec(cure, pasted)
    fit = gb.fit(
        gb.Problem(Rate(), pasted["record"], gb.OutputError(inputs="held")),
        starts=1,
        progress=False,
    )
    assert fit.estimate["a"] == pytest.approx(3.0, rel=1e-6)


@pytest.mark.parametrize(
    "units", [{}, {"q": "rad/s"}, {"q": "1/s"}, {"q": "rad s^-1"}, {"q": "furlong"}, {"T": "K"}]
)
def test_the_same_unit_in_other_words_and_unknown_ones_pass(units):
    gb.Problem(Rate(), record(**units))


def test_a_unit_of_the_users_own_is_equal_to_itself():
    class Own(Rate):
        units = {"q": "grads/s"}

    gb.Problem(Own(), record(q="grads/s"))


def test_a_unit_of_a_signal_that_is_not_there_is_a_sentence():
    class Wrong(Rate):
        units = {"theta": "rad"}

    with pytest.raises(ValueError, match="Wrong has no signal 'theta'"):
        gb.Problem(Wrong(), record())


def test_a_misspelled_unit_of_the_model_is_a_sentence():
    class Wrong(Rate):
        units = {"q": "rad/s^s"}

    with pytest.raises(ValueError, match=r"q in Wrong: the unit 'rad/s\^s' is not known: write"):
        gb.Problem(Wrong(), record())


def test_the_tilt_of_a_log_in_degrees_is_refused():
    t = 0.01 * np.arange(50)
    data = gb.Record(t, {"u": np.sin(t), "theta": np.cos(t)}, units={"theta": "deg"})
    with pytest.raises(ValueError, match=r"theta is in deg .* and in rad in NonlinearTilt"):
        gb.Problem(NonlinearTilt(), data)


def test_a_spectrum_in_other_units_is_refused_with_where_to_convert_it():
    degrees = record(180 / np.pi, q="deg/s", delta="rad", T="K")
    spectrum = gb.spectral.transient_spectrum(degrees, "delta", "q", (0.5, 20.0))
    with pytest.raises(
        ValueError,
        match=r"q is in deg/s in the spectrum .* convert the record, record = record.with",
    ):
        gb.fit(gb.Problem(Rate(), spectrum), starts=1, progress=False)


class Gain(gb.TransferFunction):
    """A rotation from a force."""

    input, output = "F", "theta"
    units = {"F": "N", "theta": "rad"}
    K = gb.Parameter(1.0)

    def response(self, s, p):
        return p.K + 0 * s


def response(input="F", output="theta", **units):
    return gb.FrequencyResponse([1.0, 2.0], [1.0, 2.0], input, output, name="test", units=units)


@pytest.mark.parametrize(
    ("units", "words"),
    [
        (
            {"theta": "deg"},
            "the output theta is in deg in the response and in rad in Gain: measure it in rad, or use SI units",
        ),
        (
            {"F": "kN"},
            "the input F is in kN in the response and in N in Gain: measure it in N, or use SI units",
        ),
        (
            {"theta": "rad/s"},
            "the output theta is in rad/s in the response and in rad in Gain: these are different quantities, take the "
            "model of the rate, or response.over_s().",
        ),
        (
            {"F": "N/s"},
            "the input F is in N/s in the response and in N in Gain: these are different quantities, take the model of "
            "the rate, or response.over_s().",
        ),
        (
            {"theta": "m"},
            "the output theta is in m in the response and in rad in Gain: these are different quantities, correct "
            "the unit or give the right signal.",
        ),
    ],
)
def test_a_response_in_other_units_is_refused_with_the_cure(units, words):
    with pytest.raises(ValueError, match=r"^[^\n]+\.$") as refused:
        check_response_units(Gain(), response(**units))
    assert str(refused.value).startswith(words)


@pytest.mark.parametrize(
    "units", [{}, {"F": "N"}, {"theta": "1"}, {"theta": "furlong"}, {"F": "kg*m/s^2"}]
)
def test_a_response_in_the_same_or_unknown_units_passes(units):
    check_response_units(Gain(), response(**units))


def test_the_only_pair_of_a_model_needs_no_names():
    data = as_the_only_pair(
        Gain(), response("lever", "attitude", lever="N", attitude="rad", other="m")
    )
    assert (data.input, data.output, data.units) == ("", "", {})
    with pytest.raises(ValueError, match="the output theta is in deg in the response"):
        as_the_only_pair(Gain(), response("lever", "attitude", attitude="deg"))
    two = response("delta", "q")
    assert as_the_only_pair(Rate(), two) is two  # which has two outputs


def test_units_that_are_not_of_si_are_met_as_they_are():
    class InDegrees(Gain):
        units = {"F": "kN", "theta": "deg"}

    check_response_units(InDegrees(), response(F="kN", theta="deg"))
    with pytest.raises(
        ValueError,
        match="theta is in rad in the response and in deg in InDegrees: measure it in deg",
    ):
        check_response_units(InDegrees(), response(F="kN", theta="rad"))
