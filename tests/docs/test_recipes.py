"""CONTRIBUTING's recipes, from a user's own file.

In Python, on the command line, with standard errors, compared.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import recipes
from command_line import run

import greybox as gb

FILE = Path(recipes.__file__)

pytestmark = pytest.mark.usefixtures("unjudged_file")


def near(fit):
    assert fit.converged
    for name, truth in recipes.TRUTH.items():
        assert 0 < fit.standard_error[name] < 0.2 * truth
        assert abs(fit.estimate[name] - truth) < 4 * fit.standard_error[name]


@pytest.fixture(scope="module")
def heun():
    return gb.fit(
        recipes.problem(), recipes.Halton(3), method=recipes.settings["method"], progress=False
    )


def test_an_integrator_and_a_rule_for_starts(heun, tmp_path):
    near(heun)
    assert "3 by Halton, seed 0" in heun.details
    usual = gb.fit(recipes.problem(), 1, progress=False)
    for name in recipes.TRUTH:
        assert heun.estimate[name] == pytest.approx(
            usual.estimate[name], abs=0.2 * usual.standard_error[name]
        )
    assert gb.compare(heun, usual).statements
    gb.save(heun, tmp_path / "heun.h5")
    assert gb.load(tmp_path / "heun.h5").cost == heun.cost
    exact = gb.simulate(recipes.Spring(), recipes.TRUTH, recipes.record())
    mine = gb.simulate(recipes.Spring(), recipes.TRUTH, recipes.record(), integrator=recipes.Heun())
    np.testing.assert_allclose(mine["x"], exact["x"], atol=1e-4)


def test_a_transcription(heun):
    fit = gb.fit(recipes.problem(), 1, method=recipes.Trapezoidal(), progress=False)
    assert fit.converged
    for name, truth in recipes.TRUTH.items():
        assert fit.standard_error[name] > 0
        assert fit.estimate[name] == pytest.approx(truth, rel=0.01)
    # At 20 Hz its errors exceed the standard errors, and the result says so.
    assert any(
        "too coarse" in warning and "MultipleShooting" in warning for warning in fit.warnings
    )
    assert fit.cost == pytest.approx(
        gb.cost(recipes.problem(), fit.estimate, method=recipes.Trapezoidal()), rel=1e-7
    )
    assert gb.compare(fit, heun).statements


def test_a_criterion_for_records(tmp_path):
    fit = gb.fit(recipes.windy(), 1, progress=False)
    near(fit)
    assert {name for name in fit.free if name.startswith("K_")} == {"K_x_x", "K_v_v"}
    other = gb.fit(
        recipes.windy().with_(criterion=gb.PredictionError(inputs="held")), 1, progress=False
    )
    assert gb.compare(fit, other).statements
    gb.save(fit, tmp_path / "windy.h5")
    assert gb.load(tmp_path / "windy.h5").criterion == "diagonal-prediction"


def test_a_criterion_for_responses():
    fit = gb.fit(recipes.response(), 10, progress=False)
    near(fit)
    assert fit.criterion == "huber"


@pytest.mark.parametrize("name", ["problem", "response"])
def test_on_the_command_line(name, capsys):
    status, out, _ = run(capsys, "fit", f"{FILE}:{name}", "--json")
    assert status == 0
    assert json.loads(out)["standard_error"]["k"] > 0
