"""Commands that judge and choose structures: `identifiability`, `orders`, `stepwise`.

Priors and regions.

What they say is what the functions of the same names return, whose tests hold it against outside
truths.
"""

import json

import numpy as np
import pytest
from command_line import OWN, refused, run
from declared_models import measured

import greybox as gb
from greybox.data.response_file import write_response
from greybox.models.polynomial import Polynomial
from greybox.problems import yaw_hover

TERMS = OWN.replace(
    "    def response",
    "    extra = gb.Parameter(0.1, bounds=(-10, 10), unit='1', about='gain beside')\n    def "
    "response",
).replace("+ 1)", "+ 1) + p.extra", 1)


@pytest.fixture(scope="module")
def yaw(tmp_path_factory):
    path = tmp_path_factory.mktemp("fits") / "yaw.h5"
    gb.save(gb.fit(yaw_hover.problem(), starts=8, profiles=False), path)
    return path


def answer(capsys, *arguments):
    status, out, _ = run(capsys, *arguments, "--json")
    assert status == 0
    return json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} in JSON"))


def test_what_a_structure_could_tell_and_what_a_fit_has_told(capsys, own, yaw):
    found = answer(
        capsys,
        "identifiability",
        "tilt:LinearTilt",
        "--outputs",
        "theta",
        "--at",
        "theta=0",
        "--fix",
        "a1=1",
    )
    assert "a1" not in found["identifiable"]
    assert {"a2", "a3", "a4"} <= set(found["identifiable"])
    lost = own(OWN.replace("p.K / (p.T", "p.K * p.T / (0.2"))
    (group,) = answer(capsys, "identifiability", lost)["groups"]
    assert (group["names"], group["directions"]) == (["K", "T"], 1)
    assert "K and T cannot be separated: fix one of them" in run(capsys, "identifiability", lost)[1]

    told = answer(capsys, "identifiability", yaw)
    assert told["beyond"] == ["a1_tilde", "a2", "a3_tilde"]
    values = {c["formula"]: c["value"] for c in told["combinations"]}
    assert values["a3_tilde/a2"] == pytest.approx(2.87, abs=0.02)
    assert "guidelines: 20 % error" in run(capsys, "identifiability", yaw)[1]
    assert "--fix is for a structure" in refused(capsys, "identifiability", yaw, "--fix", "a2=1")


def test_orders_of_a_response(capsys, tmp_path):
    table, chosen = (tmp_path / name for name in ("response.csv", "chosen.h5"))
    truth = {"b0": 8.0, "a0": 9.0, "a1": 2.0}
    write_response(measured(Polynomial(2, 0), np.geomspace(0.3, 30, 15), truth, noise=0.01), table)
    command = ("orders", table, "--n", "1", "2", "--integrators", "0", "--no-delay")
    found = answer(capsys, *command, "--out", chosen)
    assert [s["model"] for s in found["structures"] if s["chosen"]] == ["n = 2, m = 0"]
    assert found["explains"]
    assert gb.load(chosen).estimate["a0"] == pytest.approx(9.0, rel=0.02)
    assert "lower n" in refused(capsys, "orders", table, "--n", "40", "--m", "30")
    status, out, _ = run(capsys, "orders", table, "--n", "1", "--m", "0", "--no-delay")
    assert status == 1
    assert "No structure explains the data" in out


def test_terms_are_chosen(capsys, own, tmp_path):
    saved = tmp_path / "chosen.h5"
    found = answer(
        capsys,
        "stepwise",
        own(TERMS),
        "--candidates",
        "extra",
        "T=0.1",
        "--starts",
        "1",
        "--out",
        saved,
    )
    assert found["terms"] == ["T"]
    assert gb.load(saved).estimate["extra"] == 0.0
    assert {t["term"] for t in found["trials"]} == {"extra", "T"}
    assert "write NAME[=VALUE]" in refused(capsys, "stepwise", own(TERMS), "--candidates", "T=x")


def test_what_is_known_before_the_data(capsys, own):
    """The mean of data and prior, weighted by their variances."""
    name = own()
    alone = answer(
        capsys,
        "fit",
        "yaw_hover",
        "--criterion",
        "relative-likelihood",
        "--fix",
        "a2=800",
        "--starts",
        "2",
    )
    prior = answer(
        capsys, "fit", "yaw_hover", "--prior", "a4=5.0+-0.3", "--fix", "a2=800", "--starts", "2"
    )
    assert prior["prior"]["a4"]["mean"] == 5.0
    share = prior["prior"]["a4"]["share"]
    assert prior["estimate"]["a4"] == pytest.approx(
        share * 5.0 + (1 - share) * alone["estimate"]["a4"], abs=0.05
    )
    assert "NAME=VALUE+-SIGMA" in refused(capsys, "fit", name, "--prior", "K=3")
    assert "has no parameter 'L'" in refused(capsys, "fit", name, "--prior", "L=3±1")
