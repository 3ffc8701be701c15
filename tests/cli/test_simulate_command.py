"""`greybox simulate` drives a saved model, and `greybox export` writes it for other programs."""

import json
import shutil
import subprocess
import xml.etree.ElementTree as ET

import casadi as ca
import numpy as np
import pytest
from command_line import RECORD, refused, run

import greybox as gb
from greybox.models.multirotor import Rotation


@pytest.fixture
def saved(capsys, own):
    """A fitted lag of 0.3 s, its file, and a table with a step that it has not seen."""
    file = own(RECORD)
    run(capsys, "fit", file, "--starts", "2", "--out", "lag.h5")
    time = np.arange(100) / 50
    table = np.column_stack([time, np.ones(100), np.zeros(100)])
    np.savetxt("step.csv", table, "%.4f", ",", header="time [s],u [1 held],y [m]", comments="")
    return file


def test_a_step_is_simulated_from_the_stated_state(capsys, saved):
    command = ("simulate", "lag.h5", "step.csv", "--model", saved, "--out", "motion.csv")
    status, out, _ = run(capsys, *command, "--initial", "y=1")
    assert status == 0
    assert "wrote motion.csv" in out
    assert "= 0" not in out
    motion = gb.prepare(gb.read("motion.csv"), {"y": "y"})
    truth = 2 - np.exp(-motion.time / 0.3)  # of K = 2 and T = 0.3 s, from y = 1
    np.testing.assert_allclose(motion["y"], truth, atol=0.02)
    assert "exists" in refused(capsys, *command)
    _, out, _ = run(capsys, *command, "--force")
    assert ", from y = 0\n" in out


def test_a_fit_is_exported(capsys, saved):
    fit = gb.load("lag.h5", models=[saved])
    for name in ("fit.csv", "fit.json", "lag.c"):
        arguments = ("export", "lag.h5", name, "--model", saved)
        status, out, _ = run(capsys, *arguments)
        assert status == 0
        assert f"wrote {name}" in out
        assert f"{name} exists" in refused(capsys, *arguments)
    with open("fit.csv", encoding="utf-8") as file:
        header, first, *_ = [line.rstrip().split(",") for line in file]
    assert (header[:3], first[0]) == (["name", "value", "standard_error"], "K")
    assert float(first[2]) == pytest.approx(fit.standard_error["K"])
    with open("fit.json", encoding="utf-8") as file:
        assert json.load(file)["estimate"] == fit.estimate
    assert "end it in .csv" in refused(capsys, "export", "lag.h5", "fit.txt")


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_exported_c_source_is_the_model(capsys, saved, tmp_path):
    run(capsys, "export", "lag.h5", "lag.c", "--model", saved)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "lag.so", "lag.c", "-lm"], check=True)
    expected = gb.interop.to_casadi(gb.load("lag.h5", models=[saved]))
    compiled = ca.external(expected.name(), str(tmp_path / "lag.so"))
    for there, here in zip(compiled(0.3, 2.0), expected(0.3, 2.0), strict=True):
        assert float(there) == pytest.approx(float(here))


def test_a_vehicle_is_drawn_for_simulators(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(0)
    model = Rotation((4, 0.1), axes="p")
    time = np.arange(0, 3, 0.02)
    values = {name: 0.7 + 0.1 * random.normal(size=150) for name in ("u_1", "u_2", "u_3", "u_4")}
    record = gb.Record(time, values | dict.fromkeys(("q", "r"), 0 * time))
    known = {"T_rotor": 0.05, "c_2": 5.0, "j_y": 2e-3, "m": 0.5}
    p = gb.simulate(model, {**known, "j_x": 2e-3}, record)["p"] + 0.05 * random.normal(size=150)
    problem = gb.Problem(model, record.with_signals(p=p), fixed=known)
    gb.save(gb.fit(problem, 1, progress=False), "vehicle.h5")
    for name in ("vehicle.py", "v.xml"):
        assert run(capsys, "export", "vehicle.h5", name)[0] == 0
    _, out, _ = run(capsys, "export", "vehicle.h5", "v.xml", "--draws", "3", "--json")
    assert json.loads(out)["files"] == ["v_001.xml", "v_002.xml", "v_003.xml"]
    inertias = {
        float(ET.parse(f"v_00{k}.xml").find(".//inertial").get("diaginertia").split()[0])
        for k in (1, 2, 3)
    }
    assert len(inertias) == 3
    assert all(abs(J - 0.5 * 2e-3) < 2e-4 for J in inertias)
    assert "v_001.xml exists" in refused(capsys, "export", "vehicle.h5", "v.xml", "--draws", "2")
    assert "--draws is for" in refused(capsys, "export", "vehicle.h5", "v.csv", "--draws", "2")
