"""To and from python-control: its frequency responses and simulations are ours."""

import sys
import warnings

import numpy as np
import pytest
from declared_models import TILT, TILT_OMEGA, Lag, measured

import greybox as gb
from greybox.models.tilt import LinearTilt, Tilt
from greybox.reporting.interop.linear_systems import given_model

VALUES = {**TILT, "T_rotor": 0.05, "T_delay": 0.02}
DATA = measured(
    Lag(),
    TILT_OMEGA,
    {"K": 2.0, "T": 0.3},
    noise=0.01,
    columns={"coherence": np.full(len(TILT_OMEGA), 0.9)},
)
FIT = gb.fit(gb.Problem(Lag(), DATA), [{"K": 2.0, "T": 0.3}], progress=False)


@pytest.fixture(scope="module")
def control():
    return pytest.importorskip("control")


def expected(model, output="", values=VALUES, **options):
    return gb.frequency_response(model, values, TILT_OMEGA, output=output, **options).response


@pytest.mark.parametrize("pade", [1, 3])
@pytest.mark.parametrize(
    ("model", "output", "row"),
    [(Tilt(), "", 0), (LinearTilt(), "theta", 0), (LinearTilt(), "v", 1)],
)
@pytest.mark.parametrize("kind", ["transfer-function", "state-space"])
def test_models_go_there_with_their_delay_approximated(control, model, output, row, kind, pade):
    there = gb.interop.to_control(model, VALUES, kind=kind, pade=pade, output=output)
    assert type(there).__name__.lower() == kind.replace("-", "")
    found = there(1j * TILT_OMEGA, squeeze=False)[row if kind == "state-space" else 0, 0]
    np.testing.assert_allclose(found, expected(model, output, delay=f"pade:{pade}"), rtol=1e-8)
    assert there.input_labels == ["u"]


def test_a_delay_is_not_lost_without_a_word(control):
    for model in (Tilt(), LinearTilt()):
        with pytest.raises(
            ValueError, match=r"delays u by 0\.02 s, which .* cannot hold: give pade=3"
        ):
            gb.interop.to_control(model, VALUES)
    there = gb.interop.to_control(Tilt(), VALUES, pade=0)
    assert len(np.atleast_1d(np.squeeze(there.den))) == 5
    plain = gb.interop.to_control(Tilt(), {**VALUES, "T_delay": 0.0})
    np.testing.assert_allclose(
        plain(1j * TILT_OMEGA), expected(Tilt(), values={**VALUES, "T_delay": 0.0})
    )


def test_a_fit_goes_there_at_its_estimate_and_a_saved_one_too(control, tmp_path):
    gb.save(FIT, tmp_path / "fit.h5")
    for fit in (FIT, gb.load(tmp_path / "fit.h5", models=[Lag])):
        there = gb.interop.to_control(fit)
        np.testing.assert_allclose(
            there(1j * TILT_OMEGA), fit.response(TILT_OMEGA).response, rtol=1e-10
        )
        assert there.name == FIT.name


def test_responses_there_and_back(control):
    shuffled = DATA.where(np.arange(len(DATA)))
    there = gb.interop.to_control(shuffled)
    np.testing.assert_allclose(there(1j * DATA.omega), DATA.response)
    again = gb.interop.from_control(there)
    np.testing.assert_allclose(again.response, DATA.response)
    np.testing.assert_allclose(again.omega, DATA.omega)
    assert (again.input, again.output) == (DATA.input, DATA.output)


def test_linear_systems_there_and_back(control):
    theirs = control.tf([20, 40], [1, 12, 37, 170])
    for system in (theirs, control.ss(-2, 1, 3, 0)):
        model = gb.interop.from_control(system, inputs=["u"], outputs=["rate"])
        found = gb.frequency_response(model, {}, TILT_OMEGA)
        np.testing.assert_allclose(found.response, system(1j * TILT_OMEGA), rtol=1e-9)
        assert found.output == "rate"
    labels = gb.interop.from_control(control.rss(3, 2, 2))
    assert (labels.states, labels.inputs, labels.outputs) == (
        ("x1", "x2", "x3"),
        ("u1", "u2"),
        ("y1", "y2"),
    )


@pytest.mark.parametrize(
    ("convert", "kind", "words"),
    [
        (
            lambda c: gb.interop.from_control(c.tf([1], [1, 1], 0.1)),
            ValueError,
            r"sampling time of 0\.1 s",
        ),
        (lambda c: gb.interop.from_control(3), TypeError, "system is 3: give a Freq"),
        (
            lambda c: gb.interop.from_control(c.tf([[[1], [1]]], [[[1, 1], [1, 2]]])),
            ValueError,
            "2 inputs and 1 outputs",
        ),
        (
            lambda c: gb.interop.to_control(Tilt(), VALUES, kind="lpv"),
            ValueError,
            "kind is 'lpv': give 'transfer",
        ),
        (
            lambda c: gb.interop.to_control(3),
            TypeError,
            "3 cannot be converted: give a Fit, a model",
        ),
        (lambda c: gb.interop.to_control(FIT, {"K": 1}), TypeError, "values were given with a Fit"),
        (
            lambda c: gb.interop.to_control(Tilt(), {"b": 1}),
            ValueError,
            "Tilt has no parameter 'b'",
        ),
        (
            lambda c: gb.interop.to_control(LinearTilt(), VALUES, kind="transfer-function", pade=1),
            ValueError,
            "several out",
        ),
    ],
)
def test_what_cannot_be_converted_is_refused(control, convert, kind, words):
    with pytest.raises(kind, match=words):
        convert(control)


def test_without_python_control_the_sentence_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    for convert in (gb.interop.to_control, gb.interop.from_control):
        with pytest.raises(
            ModuleNotFoundError, match=r"needs control: pip install 'greybox-id\[control\]'"
        ):
            convert(DATA)


def test_names_of_signals_go_there_and_back(control):
    named = gb.FrequencyResponse([1.0, 2.0], [1j, 2.0], "da", "p", name="roll rate, 5°")
    there = gb.interop.to_control(named)
    assert (there.input_labels, there.output_labels, there.name) == (["da"], ["p"], "roll_rate_5")
    there = gb.interop.to_control(gb.FrequencyResponse([1.0, 2.0], [1j, 2.0]))
    assert (there.input_labels, there.output_labels) == (["u"], ["y"])
    two = control.ss([[-1.0, 0], [0, -2]], [[1.0, 0], [0, 1]], np.eye(2), np.zeros((2, 2)))
    model = gb.interop.from_control(two)
    assert (model.inputs, model.outputs) == (("u1", "u2"), ("y1", "y2"))
    one = gb.interop.from_control(control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], states=["v z"]))
    assert (one.inputs, one.outputs) == (("u",), ("y",))


class TwoInputs(gb.StateSpace):
    """Two lags of two inputs, of which one is delayed."""

    states, inputs, outputs = ("x", "z"), ("u", "w"), ("y",)
    delays = {"w": "tau"}
    tau = gb.Parameter(0.1)

    def derivative(self, x, u, p):
        return (u.u - x.x, 2 * u.w - 3 * x.z)

    def output(self, x, u, p):
        return (x.x + 4 * x.z + 0.5 * u.w,)


@pytest.mark.parametrize("pade", [1, 2])
def test_states_of_a_delay_are_those_of_the_input_that_it_delays(control, pade):
    there = gb.interop.to_control(TwoInputs(), {}, kind="state-space", pade=pade)
    assert there.nstates == 2 + pade
    found = there(1j * TILT_OMEGA, squeeze=False)[0]
    for row, name in zip(found, ("u", "w"), strict=True):
        wanted = gb.frequency_response(
            TwoInputs(), {}, TILT_OMEGA, input=name, delay=f"pade:{pade}"
        ).response
        np.testing.assert_allclose(row, wanted, rtol=1e-9)


def test_a_fit_is_converted_about_its_own_operating_point_or_that_which_is_stated():
    assert given_model(FIT, None, None).at == FIT.parts[0].at == {}
    assert given_model(FIT, None, {"x": 1.0}).at == {"x": 1.0}
    assert given_model(LinearTilt(), {}, None).at == {}
    assert given_model(LinearTilt(), {}, {"theta": 0.1}).at == {"theta": 0.1}


class SquareLag(gb.StateSpace):
    """A lag of the delayed input's square."""

    states, inputs, outputs, delays = ("x",), ("u",), ("y",), {"u": "T"}
    T = gb.Parameter(0.1, bounds=(0, 1), unit="s")

    def derivative(self, x, u, p):
        return (u.u**2 - x.x,)

    def output(self, x, u, p):
        return (x.x + u.u**3,)


@pytest.mark.parametrize("pade", [1, 2])
def test_a_delayed_input_rests_at_the_operating_point(control, pade):
    at = {"u": 2.0}
    there = gb.interop.to_control(SquareLag(), {}, kind="state-space", pade=pade, at=at)
    wanted = gb.frequency_response(SquareLag(), {}, [0.5, 4.0], at=at, delay=f"pade:{pade}")
    np.testing.assert_allclose(there(1j * np.array([0.5, 4.0])), wanted.response, rtol=1e-9)


class Drag(gb.StateSpace):
    """Velocity under thrust and quadratic drag."""

    states, inputs, outputs = ("v",), ("thrust",), ("v",)
    drag = gb.Parameter(0.2, bounds=(0.01, 2))

    def derivative(self, x, u, p):
        return (u.thrust - p.drag * abs(x.v) * x.v,)

    def output(self, x, u, p):
        return (x.v,)


def test_a_fitted_manoeuvre_is_converted_about_the_point_of_its_fit():
    """At a speed of 5 m/s the pole lies at -2 · 0.3 · 5 rad/s, at rest in the origin."""
    t, cruise = 0.05 * np.arange(200), {"v": 5.0}
    thrust = 0.1 * np.sign(np.sin(0.9 * t)) * (t < 8)
    flown = gb.Record(t, {"thrust": 7.5 + thrust})
    speed = gb.simulate(Drag(), {"drag": 0.3}, flown, initial=cruise)["v"]
    spectrum = gb.spectral.transient_spectrum(flown.with_signals(v=speed), "thrust", "v", (0.6, 6))
    problem = gb.Problem(Drag(), spectrum, at=cruise)
    fit = gb.fit(problem, [{}], profiles=False, progress=False)
    _, (A, *_) = given_model(fit, None, None).matrices(None)
    assert A.item() == pytest.approx(-3.0, rel=0.02)


def test_a_matrix_of_responses_returns_as_it_was(control):
    omega = np.geomspace(0.5, 20, 9)
    responses = tuple(
        gb.FrequencyResponse(omega, (k + 1j) / (1 + 1j * omega), input=u, output=y)
        for k, (y, u) in enumerate([("p", "lat"), ("p", "lon"), ("q", "lat"), ("q", "lon")])
    )
    there = gb.interop.to_control(responses)
    assert (there.ninputs, there.noutputs) == (2, 2)
    for own, again in zip(responses, gb.interop.from_control(there), strict=True):
        assert (again.output, again.input) == (own.output, own.input)
        np.testing.assert_array_equal(again.response, own.response)
    other = gb.FrequencyResponse(omega + 1, np.ones(9), input="lon", output="q")
    for wrong in (responses[:3], (*responses[:3], other)):
        with pytest.raises(ValueError, match="common frequencies"):
            gb.interop.to_control(wrong)


class Root(gb.StateSpace):
    """A tank that drains through a hole."""

    states, inputs, outputs = ("level",), ("inflow",), ("outflow",)
    c = gb.Parameter(2.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return (u.inflow - p.c * gb.sqrt(x.level),)

    def output(self, x, u, p):
        return (p.c * gb.sqrt(x.level),)


def test_a_full_operating_point_is_linearized_there_with_a_word_if_it_is_no_equilibrium():
    slope = 2.0 / (2 * np.sqrt(4.0))  # of c √level
    with pytest.warns(UserWarning, match=r"Root does not rest .* 'level' is -1\)"):
        system = gb.interop.to_control(Root(), {"c": 2.0}, at={"level": 4.0, "inflow": 3.0})
    assert np.allclose([system.A[0, 0], system.C[0, 0]], [-slope, slope])

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        system = gb.interop.to_control(Root(), {"c": 2.0}, at={"level": 4.0, "inflow": 4.0})
    assert np.allclose([system.A[0, 0], system.C[0, 0]], [-slope, slope])
