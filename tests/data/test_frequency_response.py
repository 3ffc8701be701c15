"""Measured frequency responses: what they refuse, and how they are turned to rates and back."""

import numpy as np
import pytest
from measured_responses import EXTRAS, OMEGA, RESPONSE, measured
from numpy.testing import assert_allclose

import greybox as gb


def test_what_it_holds():
    response = measured(**EXTRAS, name="pitch")
    assert len(response) == 3
    assert_allclose(response.alpha, [1, 0, -0.1])
    assert_allclose(response.beta, [1, 0.5, 0.02])
    text = "u -> theta, 3 frequencies from 1 to 4 rad/s"
    assert str(response) == f"pitch: {text}, with coherence, variance, dof, common errors"
    assert str(measured()) == f"frequency response: {text}"


def test_values_are_copied_and_read_only():
    omega = np.array(OMEGA)
    response = measured(omega=omega)
    omega[0] = 9.0
    assert response.omega[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        response.omega[0] = 9.0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            {"omega": [], "response": []},
            r"the frequency response is empty: give at least one frequency",
        ),
        ({"omega": [[1, 2, 4]]}, r"omega must be one-dimensional, but has shape \(1, 3\)"),
        ({"omega": 1.0}, r"omega must be one-dimensional, but has shape \(\)"),
        (
            {"omega": ["a", "b", "c"]},
            r"omega must be a one-dimensional array of numbers, not \['a'",
        ),
        ({"omega": [1j, 2, 3]}, r"omega must be a one-dimensional array of numbers"),
        ({"response": [1, 2]}, r"omega has 3 values but response has 2: they must match"),
        (
            {"response": [1, np.nan, 1j]},
            r"response is nan\+0j at index 1: leave out",
        ),
        ({"response": [np.inf, 1, 1j]}, r"response is inf\+0j at index 0"),
        (
            {"omega": [1, 0, 4]},
            r"omega is 0 at index 1: frequencies must be finite and above 0 rad/s",
        ),
        ({"omega": [1, 2, -4]}, r"omega is -4 at index 2"),
        ({"omega": [1, np.nan, 4]}, r"omega is nan at index 1"),
        ({"omega": [1, np.inf, 4]}, r"omega is inf at index 1"),
        (
            {"omega": [1, 2, 1]},
            r"omega = 1 rad/s is repeated: average the points .* or add two problems",
        ),
        ({"coherence": [1, 1]}, r"omega has 3 values but coherence has 2"),
        ({"coherence": [1, 0, 1]}, r"coherence is 0 at index 1: it must be above 0 and at most 1"),
        ({"coherence": [1, 1, 1.1]}, r"coherence is 1\.1 at index 2"),
        ({"coherence": [1, np.nan, 1]}, r"coherence is nan at index 1"),
        (
            {"coherence": "high"},
            r"coherence must be a one-dimensional array of numbers, not 'high'",
        ),
        ({"variance": [1, 0, 1]}, r"variance is 0 at index 1: it must be above 0\."),
        ({"variance": [1, np.inf, 1]}, r"variance is inf at index 1"),
        ({"variance": [[1, 1, 1]]}, r"variance must be one-dimensional"),
        ({"dof": [1, -2, 1]}, r"dof is -2 at index 1: it must be above 0\."),
        (
            {"common_errors": [0.1, 0.1]},
            r"common_errors has shape \(2,\): give finite numbers, a row of 3 for each",
        ),
        ({"common_errors": [1, np.nan, 0]}, r"common_errors has shape \(3,\): give finite numbers"),
        (
            {"variance": [1, 1, 1], "common_errors": [[0, 0.8, 0], [0, 0.8j, 0]]},
            r"common_errors exceed the variance at omega = 2 rad/s",
        ),
    ],
)
def test_bad_values_are_refused(words, sentence):
    with pytest.raises(ValueError, match=sentence):
        measured(**words)


# --- rates and angles


def test_times_s_multiplies_and_scales_the_variance():
    rate = measured(**EXTRAS).times_s("q")
    assert_allclose(rate.response, 1j * np.array(OMEGA) * RESPONSE)
    assert_allclose(rate.variance, np.array(EXTRAS["variance"]) * np.array(OMEGA) ** 2)
    assert_allclose(rate.common_errors, 1j * np.array(OMEGA) * EXTRAS["common_errors"])
    assert (rate.input, rate.output) == ("u", "q")
    assert_allclose(rate.coherence, EXTRAS["coherence"])


def test_over_s_divides_and_scales_the_variance():
    angle = measured(**EXTRAS).over_s()
    assert_allclose(angle.response, RESPONSE / (1j * np.array(OMEGA)))
    assert_allclose(angle.variance, np.array(EXTRAS["variance"]) / np.array(OMEGA) ** 2)
    assert angle.output == "theta"
    assert measured().over_s().variance is None


def test_a_relative_error_is_the_same_for_rate_and_angle():
    angle = measured(**EXTRAS)
    rate = angle.times_s()
    assert_allclose(
        rate.variance / np.abs(rate.response) ** 2, angle.variance / np.abs(angle.response) ** 2
    )


def test_there_and_back_again():
    response = measured(**EXTRAS)
    back = response.times_s("q").over_s("theta")
    assert_allclose(back.response, response.response, rtol=1e-15)
    assert_allclose(back.variance, response.variance, rtol=1e-15)
    assert back.output == "theta"


# --- checksum


def test_the_checksum_is_that_of_the_numbers_and_signals():
    assert measured().checksum == measured(name="another", source="elsewhere").checksum
    assert measured().checksum == measured(omega=np.array(OMEGA, dtype=np.float32)).checksum


@pytest.mark.parametrize(
    "words",
    [
        {"omega": [1.0, 2.0, np.nextafter(4.0, 5)]},
        {"response": [1 + 1j, 0.5j, -0.1 + 0.03j]},
        {"output": "phi"},
        {"input": "v"},
        {"coherence": [1.0, 1.0, 1.0]},
        {"variance": [1.0, 1.0, 1.0]},
        {"dof": [1.0, 1.0, 1.0]},
        {"common_errors": [1.0, 1.0, 1.0]},
    ],
)
def test_other_data_have_another_checksum(words):
    assert measured().checksum != measured(**words).checksum


def test_the_same_numbers_as_another_column_have_another_checksum():
    ones = [1.0, 1.0, 1.0]
    assert len({measured(**{c: ones}).checksum for c in EXTRAS}) == len(EXTRAS)


# --- files


def test_some_points_are_kept_with_all_that_belongs_to_them():
    omega = np.array([1.0, 2.0, 4.0])
    full = gb.FrequencyResponse(
        omega, omega + 1j, coherence=[0.9, 0.5, 0.8], variance=[1.0, 2.0, 3.0], name="a"
    )
    kept = full.where(full.coherence > 0.6)
    assert kept.omega.tolist() == [1.0, 4.0]
    assert kept.variance.tolist() == [1.0, 3.0]
    assert kept.name == "a"
    assert kept.dof is None
    assert_allclose(
        measured(**EXTRAS).where(omega > 1).common_errors, np.array(EXTRAS["common_errors"])[:, 1:]
    )


def test_magnitudes_are_in_decibels():
    found = gb.FrequencyResponse([1.0, 2.0, 3.0, 4.0], [10.0, -1.0, 0.1j, 0.0]).decibels
    assert found.tolist() == pytest.approx([20.0, 0.0, -20.0, -np.inf])


def test_columns_are_real_numbers_by_name():
    known = gb.FrequencyResponse(
        [2.0, 5.0],
        [1 + 2j, 3 - 4j],
        variance=[9.0, 8.0],
        common_errors=[[0.1 + 0.2j, 0.3j], [0.5, 0.6 - 0.7j]],
    )
    assert {name: values.tolist() for name, values in known.columns.items()} == {
        "alpha": [1, 3], "beta": [2, -4], "variance": [9, 8], "alpha_common1": [0.1, 0], "beta_common1": [0.2, 0.3],
        "alpha_common2": [0.5, 0.6], "beta_common2": [0, -0.7],
    }  # fmt: skip
    assert known.independent_share == pytest.approx(
        [1 - (0.05 + 0.25) / 9, 1 - (0.09 + 0.36 + 0.49) / 8]
    )
    assert gb.FrequencyResponse([2.0, 5.0], [1, 2]).independent_share.tolist() == [1, 1]
    assert (
        str(known)
        == "frequency response: input -> output, 2 frequencies from 2 to 5 rad/s, with variance, common errors"
    )


@pytest.mark.parametrize("share", [1.0, 1.001])
def test_common_errors_are_a_part_of_the_variance(share):
    """All of it at most: then nothing is independent."""
    errors = np.sqrt(share) * np.array([[3.0, 0.8j], [0.0, 0.6]])
    words = {"variance": [9.0, 1.0], "common_errors": errors}
    if share > 1:
        with pytest.raises(
            ValueError, match="common_errors exceed the variance at omega = 2 rad/s"
        ):
            gb.FrequencyResponse([2.0, 5.0], [1, 2], **words)
    else:
        assert gb.FrequencyResponse([2.0, 5.0], [1, 2], **words).independent_share == pytest.approx(
            [0, 0], abs=1e-9
        )


def test_phases_are_unwrapped_from_the_lowest_frequency_whatever_their_order():
    omega = np.array([4.0, 0.5, 8.0, 2.0])
    data = gb.FrequencyResponse(omega, 3 * np.exp(-1j * omega * 0.7))
    assert data.degrees == pytest.approx(np.degrees(-0.7 * omega))
    steps = gb.FrequencyResponse(np.arange(1, 9.0), np.exp(-0.7j * np.arange(1, 9.0)))
    assert steps.degrees == pytest.approx(np.degrees(-0.7 * np.arange(1, 9.0)))


@pytest.mark.parametrize(
    ("unit", "rate", "angle"),
    [("rad", "rad/s", "rad·s"), ("m/s", "m/s²", "m"), ("bottles", None, None), ("", None, None)],
)
def test_units_of_rates_and_angles_follow(unit, rate, angle):
    data = gb.FrequencyResponse([1.0, 2.0], [1, 2], "u", "x", units={"u": "N", "x": unit})
    assert data.times_s("y").units == {"u": "N"} | ({"y": rate} if rate else {})
    assert data.over_s("y").units == {"u": "N"} | ({"y": angle} if angle else {})


@pytest.mark.parametrize(
    ("column", "high"), [("coherence", 1.0), ("variance", np.inf), ("dof", np.inf)]
)
def test_columns_are_above_zero(column, high):
    assert (
        gb.FrequencyResponse([1.0, 2.0], [1, 2], **{column: [1e-9, min(high, 1e9)]}).columns[
            column
        ][0]
        == 1e-9
    )
    said = "above 0 and at most 1" if high == 1 else "above 0"
    for bad in (0.0, -1.0, *([1.001] if high == 1 else [])):
        with pytest.raises(
            ValueError, match=rf"^{column} is {bad:g} at index 1: it must be {said}\.$"
        ):
            gb.FrequencyResponse([1.0, 2.0], [1, 2], **{column: [0.5, bad]})


@pytest.mark.parametrize(
    ("column", "value"),
    [("omega", 1e76), ("omega", 1e-76), ("response", 1e76), ("response", 1e-76j)],
)
def test_numbers_whose_squares_are_beyond_arithmetic_are_refused(column, value):
    columns = {"omega": [1.0, 2.0, 3.0], "response": [1.0, 2.0, 0.0]}
    columns[column][1] = value
    with pytest.raises(
        ValueError, match=rf"^{column} is .* at index 1: squares of such numbers are beyond"
    ):
        gb.FrequencyResponse(**columns)


@pytest.mark.parametrize("name", ["omega", "response"])
@pytest.mark.parametrize("values", [None, np.array([1, "a", None], dtype=object)])
def test_what_is_no_array_of_numbers_is_refused_in_a_sentence(name, values):
    columns = {"omega": [1.0, 2, 3], "response": [1.0, 2j, 3]}
    with pytest.raises(ValueError, match=f"{name} must be a one-dimensional array of numbers"):
        gb.FrequencyResponse(**columns | {name: values})
    with pytest.raises(ValueError, match="omega must be"):
        gb.FrequencyResponse(None, None)
