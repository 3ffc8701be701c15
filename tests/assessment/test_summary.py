"""The numbers of a fit as plain values."""

import json
from dataclasses import replace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured

import greybox as gb

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=2)
PROBLEM = gb.Problem(
    LagLagDelay(),
    DATA,
    fixed={"tau": 0.05},
    tied={"T2": lambda p: p.T1 / 10},
    bounds={"K": (1, np.inf)},
)
FIT = gb.fit(PROBLEM, [{}], progress=False)


def test_json_says_what_python_says():
    said = json.loads(FIT.to_json(level=0.9))
    assert said == json.loads(json.dumps(FIT.to_dict(0.9)))
    assert said["criterion"] == "relative-error"
    assert said["fixed"] == {"tau": 0.05}
    assert said["tied"] == ["T2"]
    assert said["bounds"] == {"K": [1, None], "T1": [0.001, 10]}
    assert said["unit"] == {"K": "1", "T1": "s", "T2": "s", "tau": "s"}
    assert said["level"] == 0.9
    assert {name: tuple(ends) for name, ends in said["interval"].items()} == FIT.interval(0.9)
    names = said["covariance"]["names"]
    assert names == list(FIT.names)
    np.testing.assert_array_equal(said["covariance"]["values"], FIT.covariance)
    errors = np.sqrt(np.diag(said["covariance"]["values"]))
    np.testing.assert_allclose(errors, [said["standard_error"][name] for name in names], rtol=1e-12)


def test_a_fit_that_failed_has_nulls():
    failed = gb.fit(PROBLEM, [{}], solver_options={"max_iter": 0}, progress=False)
    assert not failed.converged
    said = json.loads(failed.to_json())  # NaN would be refused
    assert said["cost"] is None
    assert said["interval"]["K"] == [None, None]
    assert said["covariance"]["values"][0][0] is None


def test_json_says_which_starts_were_screened_and_how_outputs_are_fitted():
    # With profiles, the swapped lags would count, too.
    problem = gb.Problem(LagLagDelay(), DATA, fixed={"tau": 0.05})
    fit = gb.fit(problem, profiles=False, progress=False)
    said = fit.to_dict()
    assert (said["starts"], said["screened"], said["converged"], said["agreeing"]) == (
        200,
        192,
        8,
        8,
    )
    assert (said["minima"], said["best_effort"], said["outputs"], said["prior"]) == (
        1,
        None,
        [],
        {},
    )
    assert said["costs"][said["criterion"]] == pytest.approx(fit.cost, rel=1e-12)

    random = np.random.default_rng(0)
    u = np.repeat(random.normal(size=10), 8)
    record = gb.Record(
        0.1 * np.arange(80),
        {"u": u, "y": 3 * u + 0.2 * random.normal(size=80)},
        {"y": "m"},
        name="run",
    )
    measured = gb.fit(gb.Problem(Gain(), record), [{}], progress=False)
    (output,) = measured.to_dict()["outputs"]
    left = record["y"] - measured.estimate["K"] * u
    assert output["noise"] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6)
    spread = record["y"] - record["y"].mean()
    assert output["fit_percent"] == pytest.approx(
        100 * (1 - np.linalg.norm(left) / np.linalg.norm(spread))
    )
    assert (output["part"], output["output"], output["unit"]) == ("run", "y", "m")


class Gain(gb.StateSpace):
    states, inputs, outputs = (), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.K * u.u,)


@pytest.mark.parametrize(("count", "shown"), [(10, range(10)), (11, [10, 9, 8])])
def test_of_more_than_ten_responses_the_worst_three_are_shown(count, shown):
    """Response k is off by k + 1 %, and at its point k by twice as much."""
    off = 0.01 * np.arange(1, count + 1)[:, None] * (1 + np.eye(count, len(DATA)))
    parts = tuple(
        replace(FIT.parts[0], name=f"r{k}", response=DATA.response * (1 + off[k]))
        for k in range(count)
    )
    lines = [line for line in str(replace(FIT, parts=parts)).splitlines() if "largest" in line]
    assert [line.split("largest ")[1] for line in lines] == [
        f"{2 * (k + 1)} % at {DATA.omega[k]:.4g} rad/s (r{k})" for k in shown
    ]
