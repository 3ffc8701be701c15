"""What a prediction says of itself, against numbers made by hand."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

import greybox as gb
from greybox.assessment.simulation.prediction import Prediction, reported_shares, samples_ahead

STEP = 0.1
ROWS = np.array([[2, 3, 4, 5], [8, 9, 10, 11], [14, 15, 16, 17]])


@pytest.fixture
def prediction():
    random = np.random.default_rng(0)
    data = gb.Record(
        STEP * np.arange(20), {"u": np.zeros(20), "y": random.normal(size=20)}, {"y": "m"}, name="r"
    )
    return Prediction(
        label="M",
        data=data,
        inputs=("u",),
        outputs=("y",),
        states=("y", "v"),
        lead=0.2,
        horizon=0.4,
        rows=ROWS,
        predicted=data["y"][ROWS][None] - np.array([0.1, 0.2, 0.3, 0.4]),
        error=np.full((1, 3, 4), 0.3),
        noise=np.array([[0.16]]),
        trajectory=random.normal(size=(2, 3, 4)),
        one_step=random.normal(size=(1, 3, 4)),
        notes=("a note.",),
    )


def test_residuals_and_their_growth(prediction):
    assert_allclose(prediction.residual("y"), np.tile([0.1, 0.2, 0.3, 0.4], (3, 1)))
    assert prediction.rms("y") == pytest.approx(np.sqrt(np.mean(np.square([0.1, 0.2, 0.3, 0.4]))))
    assert [prediction.rms("y", share) for share in (0.01, 0.25, 0.5, 1.0)] == pytest.approx(
        [0.1, 0.1, 0.2, 0.4]
    )
    assert_allclose(prediction.ahead, [0.1, 0.2, 0.3, 0.4])
    y = prediction.data["y"][ROWS]
    wanted = 100 * (1 - np.linalg.norm(prediction.residual("y")) / np.linalg.norm(y - y.mean()))
    assert prediction.fit_percent("y") == pytest.approx(wanted)


def test_bands_are_normal_quantiles_of_error_and_noise(prediction):
    low, high = prediction.band("y", level=0.9)
    assert_allclose((high + low) / 2, prediction.predicted[0])
    assert_allclose(high - low, 2 * norm.ppf(0.95) * 0.3)
    low, high = prediction.band("y", level=0.9, noise=True)
    assert_allclose(high - low, 2 * norm.ppf(0.95) * 0.5)
    for level in (0, 1, 95):
        with pytest.raises(ValueError, match=f"level {level} must lie between 0 and 1"):
            prediction.band("y", level=level)


def test_as_a_record_it_is_missing_outside_the_windows(prediction):
    record = prediction.record
    assert set(record.signals) == {"y", "y_error", "v"}
    assert_allclose(record["y"][ROWS], prediction.predicted[0])
    assert_allclose(record["v"][ROWS], prediction.trajectory[1])
    assert np.isnan(np.delete(record["v"], ROWS.ravel())).all()
    assert (record.units["y"], record.units["y_error"]) == ("m", "m")


def test_some_windows_can_be_kept(prediction):
    some = prediction.kept(np.array([True, False, True]))
    assert len(some) == 2
    assert_allclose(some.rows, ROWS[[0, 2]])
    assert_allclose(some.predicted, prediction.predicted[:, [0, 2]])
    assert_allclose(some.one_step, prediction.one_step[:, [0, 2]])


def test_it_prints_itself(prediction):
    text = str(prediction)
    assert text.startswith(
        "M: 3 windows of 0.4 s in r, the state of each estimated from the 0.2 s before it"
    )
    header, row = text.splitlines()[2], text.splitlines()[4]
    assert header.split("  ")[-1].strip() == "standard error"
    fit = f"{prediction.fit_percent('y'):.4g}"
    assert header.split() == [
        *(
            "output unit fit % error (rms) after 0.1 s after 0.2 s after 0.4 s noise standard error".split()
        ),
    ]
    assert row.split() == [
        "y",
        "m",
        fit,
        f"{np.sqrt(0.075):.3g}",
        "0.1",
        "0.2",
        "0.4",
        "0.4",
        "0.3",
    ]
    assert text.endswith("\n\n  a note.")
    assert repr(prediction).startswith("<Prediction M: 3 windows of 0.4 s in ")


def test_rows_without_a_time_have_no_growth(prediction):
    data = gb.Record(np.arange(20.0), dict(prediction.data.signals), name="r", has_time=False)
    rows = replace(prediction, data=data, rows=ROWS[:, :1], notes=())
    rows = replace(
        rows,
        **{name: getattr(rows, name)[..., :1] for name in ("predicted", "error", "trajectory")},
    )
    lines = str(rows).splitlines()
    assert lines[0] == "M: 3 rows of r"
    assert lines[2].split() == "output unit fit % error (rms) noise standard error".split()
    assert lines[4].split()[2:] == ["0.1", "0.4", "0.3"]
    assert (rows.title, rows.window) == ("M", "row")
    assert repr(rows).startswith("<Prediction M: 3 rows of ")


def test_an_output_that_was_not_predicted_is_refused(prediction):
    with pytest.raises(ValueError, match="'v' was not predicted: give one of y"):
        prediction.measured("v")


def test_shares_of_a_horizon():
    assert [samples_ahead(share, 10) for share in (1e-12, 1e-6, 0.1, 0.11, 0.5, 1.0)] == [
        1,
        1,
        1,
        2,
        5,
        10,
    ]
    assert samples_ahead(0.3, 10) == 3  # 3.0000000000000004 - rounding is no sample
    assert reported_shares(20) == [0.1, 0.25, 0.5, 1.0]
    assert reported_shares(2) == [0.5, 1.0]
    assert reported_shares(1) == [1.0]
