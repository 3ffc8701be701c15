"""A model at its estimate as a CasADi function, as C, and in MATLAB's files."""

import re
import shutil
import subprocess

import casadi as ca
import numpy as np
import pytest
from declared_models import TILT, TILT_OMEGA, Lag, measured
from scipy import signal
from scipy.io import loadmat

import greybox as gb
from greybox.models.tilt import PAPER_G, LinearTilt, NonlinearTilt, Tilt

VALUES = {**TILT, "T_rotor": 0.05, "T_delay": 0.0, "C_x": 0.3}
STEP = 0.01
COUNT = 40


def test_the_casadi_function_is_the_formula():
    f = gb.interop.to_casadi(NonlinearTilt(), VALUES)
    assert f.name_in() == ["x", "u"]
    assert f.name_out() == ["derivative", "y"]
    v, q, theta, rotor, u = 3.0, 0.2, 0.1, 0.05, 0.4
    derivative, y = f([v, q, theta, rotor], u)
    by_hand = [
        PAPER_G * np.tan(theta) - VALUES["C_x"] * abs(v) * v,
        -VALUES["a1"] * theta - VALUES["a2"] * q - VALUES["a3"] * v + VALUES["a4"] * rotor,
        q,
        (u - rotor) / VALUES["T_rotor"],
    ]
    np.testing.assert_allclose(derivative.full().ravel(), by_hand)
    np.testing.assert_allclose(y.full().ravel(), [theta, v])
    free = gb.interop.to_casadi(NonlinearTilt(), pade=0, with_parameters=True)
    p = [VALUES[name] for name in NonlinearTilt().parameters]
    np.testing.assert_allclose(free([v, q, theta, rotor], u, p)[0].full().ravel(), by_hand)


def test_the_casadi_function_of_a_transfer_function_has_its_response():
    f = gb.interop.to_casadi(Tilt(), {**TILT, "T_delay": 0.02}, pade=2)
    x, u = ca.SX.sym("x", f.size1_in(0)), ca.SX.sym("u")
    blocks = ca.Function("blocks", [], [ca.jacobian(out, by) for out in f(x, u) for by in (x, u)])()
    A, B, C, D = (np.asarray(ca.DM(block)) for block in blocks.values())
    found = [(C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B) + D)[0, 0] for w in TILT_OMEGA]
    expected = gb.frequency_response(
        Tilt(), {**TILT, "T_delay": 0.02}, TILT_OMEGA, delay="pade:2"
    ).response
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def example(header):
    """The program in the comment at the beginning of a header."""
    lines = re.findall(r"^ \*   (.*)$", header, re.MULTILINE)
    return "\n".join(lines)


def flown_in_c(folder, model, values, size, **options):
    """Time and first output of the example in the header, with a step of this size."""
    _, header = gb.interop.write_c(model, folder / "tilt.c", values, **options)
    program = example(header.read_text()).replace("{1.0}", f"{{{size}}}")
    (folder / "example.c").write_text(program)
    strict = ["-std=c99", "-Wall", "-Werror", "-Wno-unused"]
    command = ["cc", *strict, "example.c", "tilt.c", "-lm", "-o", "example"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    out = subprocess.run([folder / "example"], check=True, capture_output=True, text=True).stdout
    return np.loadtxt(out.splitlines()).T[:, :COUNT]


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_a_stranger_compiles_the_example_and_it_flies_as_here(tmp_path):
    time, theta = flown_in_c(tmp_path, NonlinearTilt(), VALUES, 0.01)
    record = gb.Record(np.arange(COUNT) * STEP, {"u": np.full(COUNT, 0.01)}, hold={"u": np.inf})
    here = gb.simulate(NonlinearTilt(), VALUES, record)
    np.testing.assert_allclose(time, record.time, atol=1e-9)
    np.testing.assert_allclose(theta, here["theta"], rtol=1e-4, atol=5e-8)
    assert "TILT_STATE_rotor = 3" in (tmp_path / "tilt.h").read_text()


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
@pytest.mark.parametrize("step", [0.01, 0.05])
@pytest.mark.parametrize("model", [Tilt(), LinearTilt()])
def test_a_linear_model_with_a_delay_is_exact_in_c(tmp_path, model, step):
    """The poles of the Padé approximation, at 714 rad/s, are far too fast for explicit steps."""
    values = {**VALUES, "T_delay": 0.0042, "a5": 0.16}
    values = {name: values[name] for name in model.parameters}
    time, theta = flown_in_c(tmp_path, model, values, 1.0, pade=2, step=step)
    there = gb.interop.to_scipy(model, values, kind="state-space", pade=2)
    _, expected, _ = signal.lsim(there, np.ones(COUNT), np.arange(COUNT) * step)
    np.testing.assert_allclose(time, np.arange(COUNT) * step, rtol=1e-4)
    by_scipy = expected if expected.ndim == 1 else expected[:, 0]
    np.testing.assert_allclose(theta, by_scipy, rtol=1e-4, atol=1e-4 * np.abs(by_scipy).max())
    assert "exact for this linear model" in (tmp_path / "tilt.h").read_text()


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_a_nonlinear_model_with_a_delay_takes_substeps_in_c(tmp_path):
    values = {**VALUES, "T_delay": 0.0042}
    _, theta = flown_in_c(tmp_path, NonlinearTilt(), values, 0.01, pade=2)
    assert "substeps of the classical Runge-Kutta" in (tmp_path / "tilt.h").read_text()
    late = gb.interop.to_casadi(NonlinearTilt(), values, pade=2)
    x, u = ca.SX.sym("x", late.size1_in(0)), ca.SX.sym("u")
    ode = {"x": x, "u": u, "ode": late(x, u)[0]}
    advance = ca.integrator("advance", "cvodes", ode, 0, STEP, {"abstol": 1e-12, "reltol": 1e-10})
    state, expected = np.zeros(late.size1_in(0)), []
    for _ in range(COUNT):
        expected.append(float(late(state, 0.01)[1][0]))
        state = advance(x0=state, u=0.01)["xf"]
    np.testing.assert_allclose(theta, expected, rtol=1e-4, atol=5e-8)


class Friction(gb.StateSpace):
    """Linear but for a sign, whose derivative is zero."""

    states, inputs, outputs = ("v",), ("u",), ("v",)
    c = gb.Parameter(0.5)

    def derivative(self, x, u, p):
        return (u.u - p.c * gb.sign(x.v),)

    def output(self, x, u, p):
        return (x.v,)


def test_what_is_not_linear_is_not_taken_for_it(tmp_path):
    _, header = gb.interop.write_c(Friction(), tmp_path / "friction.c")
    assert "Runge-Kutta" in header.read_text()
    with pytest.raises(ValueError, match="give a shorter step"):
        gb.interop.write_c(NonlinearTilt(), tmp_path / "t.c", {**VALUES, "T_rotor": 1e-6})
    with pytest.raises(ValueError, match="above 0"):
        gb.interop.write_c(Friction(), tmp_path / "t.c", step=0)


def test_a_limit_on_one_side_is_not_linear(tmp_path):
    class Limited(Friction):
        def derivative(self, x, u, p):
            return (gb.maximum(u.u, -1.0) - p.c * x.v,)

    _, header = gb.interop.write_c(Limited(), tmp_path / "limited.c", {"c": 0.5}, step=0.05)
    assert "substeps of the classical Runge-Kutta" in header.read_text()


def test_names_from_elsewhere_do_not_leave_the_comment(tmp_path):
    class Odd(Lag):
        pass

    Odd.__name__ = "Odd*/ int main(){} /*"
    _, header = gb.interop.write_c(Odd(), tmp_path / "2 models.c")
    text = header.read_text()
    assert text.count("*/") == text.count("/*")
    assert "void m_2_models_step(" in text


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda p: gb.interop.write_c(Lag(), p / "lag.cpp"),
            r"lag\.cpp is to be C source: end it in \.c",
        ),
        (
            lambda p: gb.interop.write_c(Tilt(), p / "t.c"),
            "delays u by .*: give pade=3",
        ),
        (lambda p: gb.interop.write_mat(RECORD, p / "a.h5"), r"end it in \.mat"),
        (lambda p: gb.interop.write_c(Lag(), p / "no" / "lag.c"), "cannot be written"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, call, words):
    with pytest.raises((ValueError, OSError), match=words):
        call(tmp_path)
    assert list(tmp_path.iterdir()) == []


# --- MATLAB

RECORD = gb.Record(
    np.arange(5) * 0.1,
    {"RATE.POut": np.arange(5.0), "theta": np.ones(5)},
    {"RATE.POut": "1", "theta": "rad"},
    name="flight",
)


def test_a_record_for_matlab_and_back(tmp_path):
    gb.interop.write_mat(RECORD, tmp_path / "flight.mat")
    there = loadmat(tmp_path / "flight.mat", simplify_cells=True)
    np.testing.assert_array_equal(there["time"], RECORD.time)
    np.testing.assert_array_equal(there["RATE_POut"], RECORD["RATE.POut"])
    assert there["units"] == {"RATE_POut": "1", "theta": "rad"}
    (again,) = gb.read(tmp_path / "flight.mat").values()
    np.testing.assert_array_equal(again["RATE_POut"], RECORD["RATE.POut"])
    np.testing.assert_array_equal(again.time, RECORD.time)


def test_a_response_and_a_fit_for_matlab(tmp_path):
    data = measured(Lag(), TILT_OMEGA, {"K": 2.0, "T": 0.3}, noise=0.02)
    fit = gb.fit(gb.Problem(Lag(), data), starts=4, progress=False)
    gb.interop.write_mat(fit, tmp_path / "fit.mat")
    there = loadmat(tmp_path / "fit.mat", simplify_cells=True)["fit"]
    assert there["estimate"] == fit.estimate
    assert there["criterion"] == "relative-error"
    np.testing.assert_array_equal(there["covariance"]["values"], fit.covariance)
    assert tuple(there["covariance"]["names"]) == fit.names
    assert tuple(there["interval"]["K"]) == fit.interval()["K"]
    part = there["part"]
    np.testing.assert_array_equal(part["data"]["response"], data.response)
    np.testing.assert_array_equal(part["fitted"], fit.parts[0].response)

    gb.interop.write_mat(data, tmp_path / "data.mat")
    np.testing.assert_array_equal(
        loadmat(tmp_path / "data.mat", simplify_cells=True)["omega"], data.omega
    )

    linear = {**TILT, "T_rotor": 0.05, "T_delay": 0.0}
    flown = gb.simulate(LinearTilt(), linear, gb.Record(np.arange(20) * 0.05, {"u": np.ones(20)}))
    known = {name: value for name, value in linear.items() if name != "a4"}
    in_time = gb.fit(
        gb.Problem(LinearTilt(), flown.with_signals(u=np.ones(20)), fixed=known),
        [{}],
        progress=False,
    )
    gb.interop.write_mat(in_time, tmp_path / "time.mat")
    part = loadmat(tmp_path / "time.mat", simplify_cells=True)["fit"]["part"]
    np.testing.assert_array_equal(part["data"]["theta"], flown["theta"])


class Integrator(gb.StateSpace):
    """Without a parameter."""

    states, inputs, outputs = ("x",), ("u",), ("x",)

    def derivative(self, x, u, p):
        return (u.u,)

    def output(self, x, u, p):
        return (x.x,)


def test_the_header_names_the_parameters_or_that_there_are_none(tmp_path):
    _, header = gb.interop.write_c(Integrator(), tmp_path / "integrator.c", {})
    assert "It has no parameters." in header.read_text()
    _, header = gb.interop.write_c(NonlinearTilt(), tmp_path / "tilt.c", VALUES)
    said = header.read_text()
    assert f"a1 = {VALUES['a1']:.6g}, a2 = {VALUES['a2']:.6g}" in said
    assert "It has no parameters." not in said


def test_what_is_no_data_is_not_written_for_matlab(tmp_path):
    with pytest.raises(
        TypeError,
        match="3 cannot be written for MATLAB: give a Fit, a Record or a FrequencyResponse",
    ):
        gb.interop.write_mat(3, tmp_path / "three.mat")
    assert not [*tmp_path.iterdir()]
