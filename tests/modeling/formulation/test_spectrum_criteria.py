"""What fits a manoeuvre's spectrum, and every refusal with its cure."""

import re

import numpy as np
import pytest

import greybox as gb
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.modeling.formulation.spectrum_criteria import outputs_in_spectrum

GRID = 2 * np.pi / 8 * np.arange(2, 7)  # of 8 s


class Cart(gb.StateSpace):
    """Two states behind two inputs, three outputs."""

    states, inputs, outputs = ("x", "v"), ("F", "wind"), ("v", "x", "a")
    b = gb.Parameter(1.0)

    def derivative(self, x, u, p):
        return x.v, u.F - p.b * (x.v - u.wind)

    def output(self, x, u, p):
        return x.v, x.x, u.F - p.b * (x.v - u.wind)


def spectrum(inputs=("F", "wind"), outputs=("x", "v")):
    values = {name: np.exp(1j * GRID * k) for k, name in enumerate((*inputs, *outputs), 1)}
    return TransientSpectrum(
        GRID,
        {name: values[name] for name in inputs},
        {name: values[name] for name in outputs},
        8.0,
        0.02,
    )


@pytest.mark.parametrize(
    ("criterion", "outputs", "compared"),
    [
        (gb.OutputError(), ("a", "x", "v"), ("v", "x", "a")),
        (gb.OutputError(noise={"x": 0.1}), ("x", "other"), ("x",)),
        (gb.EquationError(), ("x", "v"), ("v", "x")),
        (gb.EquationError(), ("a",), ("a",)),
    ],
)
def test_outputs_are_compared_in_the_order_of_the_model(criterion, outputs, compared):
    data = spectrum(outputs=outputs)
    assert outputs_in_spectrum(criterion, Cart(), data) == compared
    gb.Problem(Cart(), data, criterion)
    erring = "differential equation" if isinstance(criterion, gb.EquationError) else "outputs"
    assert (
        criterion.condition_on(data)
        == f"errors of the {erring} whose size changes slowly over the band, as in light turbulence, "
        "and known inputs"
    )


@pytest.mark.parametrize(
    ("criterion", "data", "words"),
    [
        (
            gb.PredictionError(),
            {},
            "PredictionError is for records and the data are a TransientSpectrum: use",
        ),
        (
            gb.OutputError(inputs="held"),
            {},
            "inputs of OutputError is for records and the data are a TransientSpectrum, ",
        ),
        (
            gb.OutputError(biases=("x",)),
            {},
            "biases of OutputError is for records and the data are a Transient",
        ),
        (
            gb.EquationError(initial={"x": 1.0}),
            {},
            "initial of EquationError is for records and the data are a ",
        ),
        (
            gb.OutputError(),
            {"inputs": ("F", "rain")},
            "Cart needs the input 'wind', which the spectrum does not have: rename one of its signals, F, rain.",
        ),
        (
            gb.OutputError(),
            {"outputs": ("y", "z")},
            "the spectrum has none of the outputs of Cart (v, x, a); it has y, z.",
        ),
        (
            gb.OutputError(noise={"x": 0.1}),
            {},
            "noise gives no standard deviation for 'v': add it, or use noise='diagonal'.",
        ),
        (
            gb.EquationError(),
            {"outputs": ("x", "v", "a")},
            "EquationError compares one output, or as many as Cart has states (2), and the spectrum has v, x, a: use "
            "OutputError(), or leave outputs out of the spectrum.",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused(criterion, data, words):
    with pytest.raises(ValueError, match=f"^{re.escape(words)}"):
        gb.Problem(Cart(), spectrum(**data), criterion)


def test_the_errors_of_an_equation_have_no_stated_size():
    with pytest.raises(
        ValueError, match=r"^EquationError estimates the size .*: leave out noise\.$"
    ):
        gb.EquationError(noise={"x": 0.1})
