"""What an answer keeps of a record: every field, against the residuals and against least squares by hand."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Two(gb.StateSpace):
    """A lag, seen as it is and doubled."""

    states, inputs, outputs = ("x",), ("u",), ("y", "z")
    a = gb.Parameter(1.0, bounds=(0.1, 20), unit="1/s")

    def derivative(self, x, u, p):
        return (p.a * (u.u - x.x),)

    def output(self, x, u, p):
        return (x.x, 2 * x.x)


def flown():
    """Two stretches, with samples of one output missing."""
    random, n = np.random.default_rng(0), 120
    time = 0.05 * np.arange(n) + np.where(np.arange(n) < 70, 0.0, 3.0)
    u = np.repeat(random.normal(size=n // 10), 10)
    x = np.zeros(n)
    for k in range(1, n):
        x[k] = 0 if k == 70 else u[k - 1] + (x[k - 1] - u[k - 1]) * np.exp(-3.0 * 0.05)
    y, z = x + 0.05 * random.normal(size=n), 2 * x + 0.2 * random.normal(size=n)
    y[10:15] = np.nan
    return gb.Record(
        time,
        {"u": u, "y": y, "z": z, "other": u},
        {"y": "m", "other": "m"},
        name="flight",
        hold={"u": np.inf},
    )


@pytest.mark.parametrize("noise", ["diagonal", "full", {"y": 0.05, "z": 0.2}])
def test_every_field_of_a_fitted_record(noise):
    record = flown()
    criterion = gb.OutputError(noise=noise, initial={"x": lambda p: 0.0})
    fit = gb.fit(gb.Problem(Two(), record, criterion), starts=[{}], progress=False)
    (part,) = fit.records
    assert list(part.data.signals) == ["u", "y", "z"]
    assert (part.data.units, part.data.name, part.outputs) == ({"y": "m"}, "flight", ("y", "z"))
    assert part.data.hold == {"u": np.inf}
    assert part.inputs == "record"
    assert part.between == {"u": "held until the next sample, as the record says"}
    assert (part.simulated.name, part.biases, part.gains, part.driven, part.added) == (
        "Two",
        (),
        (),
        (),
        (),
    )
    assert (part.gain, part.gain_slope, part.is_static) == (None, None, False)
    assert part.label == "Two"
    assert part.equation == "A lag, seen as it is and doubled."
    assert part.compared == (
        115 if noise == "full" else 120
    )  # of a full covariance, samples with both

    a, u = fit.estimate["a"], record["u"]
    x = np.zeros(120)
    x[70] = part.initial["x"][1]
    for k in (*range(1, 70), *range(71, 120)):
        x[k] = u[k - 1] + (x[k - 1] - u[k - 1]) * np.exp(-a * 0.05)
    assert part.initial["x"][0] == 0
    rows = np.isfinite(part.simulated["z"])
    assert_allclose(part.simulated["y"][rows], x[rows], atol=1e-4)
    assert_allclose(part.simulated["z"][rows], 2 * x[rows], atol=2e-4)
    left = np.array([part.residual("y"), part.residual("z")])
    there = np.nan_to_num(left)
    if noise == "diagonal":
        assert_allclose(
            part.noise, np.diag([np.nanmean(left[0] ** 2), np.mean(left[1] ** 2)]), rtol=1e-6
        )
        assert part.nuisances == 1 + 2  # the initial state of the second stretch, and the variances
    elif noise == "full":  # of samples with both
        both = there[:, np.isfinite(left[0])]
        assert_allclose(part.noise, both @ both.T / both.shape[1], rtol=1e-5)
        assert part.nuisances == 1 + 3
    else:
        assert_allclose(part.noise, np.diag([0.05**2, 0.2**2]))
        assert part.nuisances == 1
    known = np.isfinite(left[1])
    spread = record["z"][known] - record["z"][known].mean()
    percent = 100 * (1 - np.linalg.norm(left[1][known]) / np.linalg.norm(spread))
    assert part.fit_percent("z") == pytest.approx(percent)
    assert part.innovation_parameters("y") == 0


def test_parameters_that_a_criterion_adds_and_whether_two_are_the_same():
    criteria = (
        gb.OutputError(),
        gb.OutputError(),
        gb.OutputError(noise="full"),
        gb.PredictionError(),
    )
    one, same, full, predicted = (
        gb.fit(gb.Problem(Two(), flown(), criterion), starts=[{}], progress=False).records[0]
        for criterion in criteria
    )
    assert one.has_criterion_of(same)
    assert not one.has_criterion_of(full)
    assert not one.has_criterion_of(predicted)
    assert predicted.gains == (("x", "y"), ("x", "z"))
    assert predicted.added == ("K_x_y", "K_x_z")
    assert [predicted.innovation_parameters(name) for name in ("y", "z", "x")] == [1, 1, 0]
    assert predicted.nuisances == 2 + 2
    more = replace(predicted, biases=("u",), gains=(("x", "y"), ("x", "z"), ("v", "y")))
    assert more.added == ("u_bias", "K_x_y", "K_x_z", "K_v_y")
    assert more.innovation_parameters("y") == 2
    driven = replace(more, driven=("x", "v", "w"))
    assert driven.added == ("u_bias", "w_x", "w_v", "w_w", "v_y", "v_z")
    assert driven.innovation_parameters("y") == 3
    assert replace(one, is_static=True).between == {}
    assert not one.is_prior
