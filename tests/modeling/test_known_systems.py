"""Linear systems with known numbers, held against numpy's polynomials and matrices."""

import numpy as np
import pytest
from declared_models import TWO_LAGS_OMEGA, Lag, measured

import greybox as gb
from greybox.modeling.known_systems import KnownStateSpace, KnownTransferFunction
from greybox.modeling.model_reference import reference, resolve

S = 1j * TWO_LAGS_OMEGA
A, B, C, D = [[0, 1], [-5, -3]], [[0], [2]], [[1, 0.5], [0, 1]], [[0], [0.25]]


def test_a_ratio_of_polynomials():
    model = KnownTransferFunction([0, 1, 2], (1, 3, 5), "u", "theta", prefix="f_")
    assert list(model.parameters) == ["f_b1", "f_b0", "f_a2", "f_a1", "f_a0"]
    found = gb.frequency_response(model, {}, TWO_LAGS_OMEGA)
    np.testing.assert_allclose(found.response, np.polyval([1, 2], S) / np.polyval([1, 3, 5], S))
    assert (found.input, found.output) == ("u", "theta")


def test_matrices():
    model = KnownStateSpace(A, B, C, D, inputs=["elevator"])
    assert (model.states, model.inputs, model.outputs) == (
        ("x1", "x2"),
        ("elevator",),
        ("y1", "y2"),
    )
    assert model.parameters == {}
    for k, name in enumerate(model.outputs):
        expected = [(C @ np.linalg.solve(s * np.eye(2) - A, B) + D)[k, 0] for s in S]
        found = gb.frequency_response(model, {}, TWO_LAGS_OMEGA, output=name)
        np.testing.assert_allclose(found.response, expected, rtol=1e-10)
    gain = KnownStateSpace([], [], [], [[2, 3]])
    assert gain.is_static
    assert gain.inputs == ("u1", "u2")


def test_a_known_filter_before_a_plant_leaves_the_plant_to_be_found():
    known = KnownTransferFunction([10], [1, 10], "u", "filtered", prefix="filter_")
    truth = {"K": 2.0, "T": 0.3}
    data = measured(known * Lag(), TWO_LAGS_OMEGA, truth)
    found = gb.fit(gb.Problem(known * Lag(), data), starts=6, progress=False)
    assert found.free == ("K", "T")
    assert {name: found.estimate[name] for name in truth} == pytest.approx(truth)
    # One of its numbers set free is found too, within bounds for its start.
    freed = gb.Problem(
        known * Lag(), data, free=["filter_b0"], fixed={"K": 2.0}, bounds={"filter_b0": (1, 50)}
    )
    assert gb.fit(freed, starts=6, progress=False).estimate["filter_b0"] == pytest.approx(10)


@pytest.mark.parametrize(
    "model", [KnownTransferFunction([1], [1, 2]), KnownStateSpace(np.array(A), B, C, D)]
)
def test_a_stored_result_knows_it(model):
    again = resolve(reference(model))
    assert repr(again) == repr(model)
    assert again.parameters == model.parameters


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: KnownTransferFunction([1], [0, 0]), "the denominator is zero"),
        (
            lambda: KnownTransferFunction([np.nan], [1]),
            "the numerator is .* give finite coefficients",
        ),
        (
            lambda: KnownStateSpace(A, [[1]], C, D),
            r"B has shape \(1, 1\) where the others need \(2, 1\)",
        ),
        (lambda: KnownStateSpace(A, B, C, D, states=["x"]), "are the names of 2 signals"),
        (
            lambda: KnownStateSpace([[np.inf, 0], [0, 1]], B, C, D),
            "A has an entry that is not finite",
        ),
    ],
)
def test_numbers_that_are_no_system_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_signals_without_names_are_numbered_where_there_are_several_and_states_always():
    model = KnownStateSpace([[-1]], [[1]], [[1]], [[0]])
    assert (model.states, model.inputs, model.outputs) == (("x1",), ("u",), ("y",))
    named = KnownStateSpace([[-1]], [[1]], [[1]], [[0]], states=["q"], inputs=["F"], outputs=["v"])
    assert (named.states, named.inputs, named.outputs) == (("q",), ("F",), ("v",))
    ratio = KnownTransferFunction([3, 1], [1, 2])
    assert all(p.fixed for p in ratio.parameters.values())
    assert {name: p.start for name, p in ratio.parameters.items()} == {
        "b1": 3.0,
        "b0": 1.0,
        "a1": 1.0,
        "a0": 2.0,
    }


@pytest.mark.parametrize("outputs", [1, 3])
def test_there_may_be_more_or_fewer_outputs_than_states(outputs):
    c = np.array([[1, 0.5], [0, 1], [2, -3]])[:outputs]
    d = np.array([[0.25], [0], [1]])[:outputs]
    model = KnownStateSpace(A, B, c, d)
    x, u, p = {"x1": 2.0, "x2": -1.0}, {"u": 3.0}, model.values()
    assert model.output(x, u, p) == pytest.approx(c @ [2, -1] + d[:, 0] * 3)
    assert model.derivative(x, u, p) == pytest.approx(np.array(A) @ [2, -1] + np.array(B)[:, 0] * 3)
