"""What an answer keeps of a part, and what follows from it."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.assessment.fitted_part import FittedPart, FittedRecord, FittedSpectrum

STATED = {
    **dict.fromkeys((field.name for field in dataclasses.fields(FittedPart)), ""),
    "settings": {},
    "rename": {},
    "model": {},
}
TIME = np.arange(5.0)
MEASURED = {
    "y": np.array([1.0, 4.0, np.nan, 2.0, 5.0]),
    "z": np.array([np.nan, 0.5, np.nan, np.nan, -0.5]),
}
FITTED = {"y": np.array([2.0, 4.0, 3.0, np.nan, 4.0]), "z": np.array([0.0, 0.5, 0.0, 0.0, np.nan])}


def kept(**changes):
    given = STATED | {
        "data": gb.Record(TIME, {"u": TIME, **MEASURED}),
        "simulated": gb.Record(TIME, FITTED),
        "outputs": ("y", "z"),
        "noise": np.eye(2),
        "initial": {},
        "method": "",
    }
    return FittedRecord(**(given | changes))


def test_residuals_are_compared_where_both_are_there():
    part = kept()
    assert_allclose(part.residual("y"), [-1, 0, np.nan, np.nan, 1])
    assert part.compared == 3  # rows 0, 1 and 4
    y, p = np.array([1.0, 4.0, 5.0]), np.array([2.0, 4.0, 4.0])
    assert part.fit_percent("y") == pytest.approx(
        100 * (1 - np.linalg.norm(y - p) / np.linalg.norm(y - y.mean()))
    )


def test_parameters_that_a_criterion_adds_have_their_names():
    gains = (("x", "y"), ("v", "y"), ("v", "z"))
    plain = kept(biases=("y",), gains=gains)
    assert plain.added == ("y_bias", "K_x_y", "K_v_y", "K_v_z")
    assert [plain.innovation_parameters(name) for name in ("y", "z")] == [2, 1]
    driven = kept(biases=("y",), gains=gains, driven=("v",))
    assert driven.added == ("y_bias", "w_v", "v_y", "v_z")
    assert [driven.innovation_parameters(name) for name in ("y", "z")] == [1, 1]
    assert kept(is_static=True).between == {}
    assert [*kept().between] == ["u"]


def test_criteria_are_the_same_with_the_same_settings():
    one = kept(criterion_class="a:B", settings={"x": 1})
    assert one.has_criterion_of(kept(criterion_class="a:B", settings={"x": 1}))
    assert not one.has_criterion_of(kept(criterion_class="a:B", settings={"x": 2}))
    assert not one.has_criterion_of(kept(criterion_class="a:C", settings={"x": 1}))


def test_spectra_are_reproduced_to_the_share_of_their_power_that_is_not_left():
    class Data:
        outputs = {"q": np.array([3 + 4j, 0.0, 12.0]), "r": np.zeros(3)}

    fitted = {"q": np.array([3 + 4j, 5.0, 12.0]), "r": np.ones(3)}
    stated = {"data": Data(), "fitted": fitted, "outputs": ("q", "r"), "noise": np.eye(2)}
    part = FittedSpectrum(**(STATED | stated), ends={})
    assert_allclose(part.residual("q"), [0, -5, 0])
    assert part.fit_percent("q") == pytest.approx(100 * (1 - 5 / 13))
    assert np.isnan(part.fit_percent("r"))
