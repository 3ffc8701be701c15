"""Every shipped model: its declaration, its readings, and the derivations between the paper's equations."""

import re

import numpy as np
import pytest
from evaluation import compiled_response, input_output_pairs, random_values, shipped_models
from numpy.testing import assert_allclose

import greybox as gb
from greybox.modeling.model import equation
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.trim import derivative_function
from greybox.models.coupled import (
    CoupledVelocity,
    CoupledVelocityTransfer,
    DampedCoupledVelocity,
    DampedCoupledVelocityTransfer,
    LaggedCoupledVelocity,
)
from greybox.models.multirotor import EulerKinematics, LimitedMixer, Mixer, RigidBody, Torques
from greybox.models.polynomial import Polynomial
from greybox.models.rate import BasicAngle, BasicRate, DampedRate, YawRateLag, YawRateLead
from greybox.models.rotor import Rotor
from greybox.models.tilt import PAPER_G, LinearTilt, NonlinearTilt, Tilt
from greybox.models.yaw import YawAngle, YawRate, YawStates

SHIPPED = shipped_models()
OMEGA = np.geomspace(0.3, 40, 12)
ATTITUDE = {"phi": 0.3, "theta": -0.4, "psi": 2.0}
# Each model at the origin, those of variable order in more sizes, those that are nonlinear
# elsewhere too.
CASES = [(model(), {}) for model in SHIPPED.values()] + [
    (Polynomial(4, 1, integrator=True), {}),
    (Polynomial(6, 5), {}),
    (Polynomial(1, 0, integrator=True), {}),
    (NonlinearTilt(), {"theta": 0.0873}),
    (EulerKinematics(), ATTITUDE),
    (RigidBody(), ATTITUDE),
    (Torques(), {"Omega_1": 500.0, "Omega_2": 510.0, "Omega_3": 480.0, "Omega_4": 520.0}),
]
# Without a delay, Padé's readings are the exact ones: those of Polynomial represent them all.
READINGS = [(model, at, "exact") for model, at in CASES] + [
    (model, at, "pade:3")
    for model, at in CASES
    if "T_delay" in model.parameters or isinstance(model, Polynomial)
]


def draws(model, count=3):
    random = np.random.default_rng(1)
    return [random_values(model, random) for _ in range(count)]


def response(model, values, **options):
    return gb.frequency_response(model, values, OMEGA, **options).response


# --- declarations


def test_the_equations_of_the_paper_are_all_there():
    found = set(
        re.findall(r"\((\d\.\d+)\)", " ".join(equation(model) for model in SHIPPED.values()))
    )
    wanted = (
        "2.1 2.2 2.3 2.4 2.5 2.6 2.7 2.8 2.9 2.10 2.11 2.12 2.13 4.21 4.23 4.24 4.25 4.33 4.34 4.37"
    )
    assert found >= set(wanted.split())


@pytest.mark.parametrize("name", SHIPPED)
def test_docstring_has_sentence_equation_and_source(name):
    text = equation(SHIPPED[name])
    assert re.match(r"[A-Z].*\.\n\n", text)
    assert text.count("$$") == 2
    source = re.search(r"^Source: (.*?)\.$", text, re.MULTILINE | re.DOTALL)
    assert source
    if source[1].startswith("Frequency Domain Identification"):
        assert re.search(r"\(\d\.\d+\)$", source[1])
        assert re.match(r".*\(\d\.\d+\)", text)


@pytest.mark.parametrize("model", [model for model, _ in CASES], ids=repr)
def test_every_parameter_has_finite_bounds_unit_and_meaning(model):
    for parameter in model.parameters.values():
        assert np.all(np.isfinite(parameter.bounds))
        assert parameter.unit
        assert len(parameter.about) > 3


@pytest.mark.parametrize(
    "models", [(Tilt, LinearTilt, NonlinearTilt), (YawRate, YawAngle, YawStates)]
)
def test_forms_of_one_structure_declare_shared_parameters_alike(models):
    first, *others = (model.parameters for model in models)
    for other in others:
        shared = first.keys() & other.keys()
        assert shared >= {"a2", "a4", "T_rotor", "T_delay"}
        assert all(first[name] == other[name] for name in shared)


# --- readings


@pytest.mark.parametrize(
    ("model", "at", "delay"), READINGS, ids=lambda value: repr(value).replace(" ", "")
)
def test_numbers_casadi_and_rational_form_agree(model, at, delay):
    # Every input and every output takes part.
    inputs, outputs = model.input_names, model.output_names
    for k in range(max(len(inputs), len(outputs))):
        u, y = inputs[k % len(inputs)], outputs[k % len(outputs)]
        options = {"input": u, "output": y} | ({"at": at} if at else {})
        compiled = compiled_response(model, OMEGA, delay, **options)
        for values in draws(model, 1):
            numbers = response(model, values, delay=delay, **options)
            assert_allclose(compiled(values), numbers, rtol=1e-12)
            form = gb.modeling.rational(model, values, pade=delay_order(delay), **options)
            # Rounding moves multiple poles, such as those of four equal rotors.
            assert_allclose(
                form(1j * OMEGA), numbers, rtol=1e-8 if "w_2" in model.state_names else 1e-10
            )


@pytest.mark.parametrize(
    "model",
    [m for m, _ in CASES if "T_delay" in m.parameters and m.parameters["T_delay"].start],
    ids=repr,
)
def test_a_pade_reading_is_close_to_the_exact_delay_and_has_none_itself(model):
    for u, y in input_output_pairs(model):
        pair = {"input": u, "output": y}
        exact, pade = (response(model, None, delay=delay, **pair) for delay in ("exact", "pade:3"))
        assert_allclose(pade, exact, rtol=1e-7)
        if not np.any(exact):
            continue  # this input does not act on this output
        assert not np.array_equal(pade, exact)
        assert gb.modeling.rational(model, **pair).delay == model.parameters["T_delay"].start
        assert gb.modeling.rational(model, pade=3, **pair).delay == 0


# --- derivations of section 2


def test_kinematics_invert_the_body_rates_of_the_euler_angle_sequence():
    """The inverse of (2.1), from the rotation sequence yaw, pitch, roll."""
    random = np.random.default_rng(2)
    for _ in range(20):
        phi, theta, psi, *rates = random.uniform(-1.4, 1.4, 6)
        z = np.array([phi, theta, psi, *rates])
        dphi, dtheta, dpsi = np.asarray(derivative_function(EulerKinematics())(z, [])).ravel()
        p = dphi - dpsi * np.sin(theta)
        q = dtheta * np.cos(phi) + dpsi * np.sin(phi) * np.cos(theta)
        r = -dtheta * np.sin(phi) + dpsi * np.cos(phi) * np.cos(theta)
        assert_allclose([p, q, r], rates, rtol=1e-12, atol=1e-14)


def test_rigid_body_satisfies_eulers_equation_in_vector_form():
    """(2.2) is J ω' + ω × J ω = τ; the angles follow `EulerKinematics`."""
    random = np.random.default_rng(3)
    for values in draws(RigidBody(), 20):
        state, torque = random.uniform(-1.4, 1.4, 6), random.uniform(-1, 1, 3)
        J, rates = np.array(list(values.values())), state[3:]
        z = np.concatenate([state, torque])
        derivative = np.asarray(derivative_function(RigidBody())(z, J)).ravel()
        assert_allclose(
            J * derivative[3:] + np.cross(rates, J * rates), torque, rtol=1e-10, atol=1e-12
        )
        kinematics = derivative_function(EulerKinematics())(state, [])
        assert_allclose(derivative[:3], np.asarray(kinematics).ravel(), rtol=1e-13)


def test_roll_torque_per_rotor_speed_is_eight_and_per_control_four():
    """The printed 4 of (2.5) includes the mixer's 0.5.

    With Ω_i = Ω_F ± Ω_φ in the signs of (2.3) the torque is 8 K_τ Ω_F Ω_φ (the paper prints 4 above
    (2.5)). The mixer passes 0.5 u_φ to each rotor, so from u_φ it is 4 K_τ Ω_F K_Ω, as K_φ of (2.5)
    says. Yaw has no
    0.5, so there it is 8 K_ψ Ω_F K_Ω.
    """
    K_tau, K_psi, Omega_F, K_Omega = 3e-6, 4e-7, 600.0, 1033.0
    at = {f"Omega_{i}": Omega_F for i in range(1, 5)}
    torques = gb.modeling.linearize(Torques(), {"K_tau": K_tau, "K_psi": K_psi}, at).D
    assert_allclose(torques @ [-1, 1, 1, -1], [8 * K_tau * Omega_F, 0, 0], rtol=1e-12)
    per_control = torques @ (K_Omega * np.eye(4)) @ gb.modeling.linearize(Mixer()).D
    roll, yaw = 4 * K_tau * Omega_F * K_Omega, 8 * K_psi * Omega_F * K_Omega
    assert_allclose(
        per_control, [[0, roll, 0, 0], [0, 0, roll, 0], [0, 0, 0, yaw]], rtol=1e-12, atol=1e-15
    )


def test_basic_rate_and_angle_are_mixer_rotor_torques_and_body_in_series():
    """(2.5) and (2.6) from (2.1) to (2.4), each linearized at hover."""
    K_tau, Omega_F, J_x = 3e-6, 600.0, 0.012
    rotor = {"K_Omega": 1033.0, "T_rotor": 0.048, "T_delay": 0.0042}
    torques = gb.modeling.linearize(
        Torques(), {"K_tau": K_tau}, {f"Omega_{i}": Omega_F for i in range(1, 5)}
    ).D
    gain = torques[0] @ gb.modeling.linearize(Mixer()).D[:, 1]
    K_phi = 4 * K_tau * Omega_F * rotor["K_Omega"] / J_x
    for model, y in ((BasicRate(), "p"), (BasicAngle(), "phi")):
        body = response(RigidBody(), {"J_x": J_x}, input="tau_phi", output=y)
        chain = gain * response(Rotor(), rotor) * body
        basic = {"K_phi": K_phi, "T_rotor": rotor["T_rotor"], "T_delay": rotor["T_delay"]}
        assert_allclose(response(model, basic), chain, rtol=1e-10)


@pytest.mark.parametrize("values", draws(DampedRate()))
def test_damped_rate_has_the_poles_its_parameters_name(values):
    """(2.7): a zero at the origin, a pole at -1/T_1, and a pair of size omega_p at the angle that xi says."""
    form = gb.modeling.rational(DampedRate(), values)
    assert np.roots(form.numerator) == [0.0]
    poles = np.roots(form.denominator)
    pair = np.roots([1, 2 * values["xi"] * values["omega_p"], values["omega_p"] ** 2])
    assert_allclose(np.sort_complex(poles), np.sort_complex([-1 / values["T_1"], *pair]), rtol=1e-8)
    assert_allclose(np.prod(pair), values["omega_p"] ** 2, rtol=1e-12)
    slope = form.numerator[0] / form.denominator[-1]  # of the response at s = 0
    assert_allclose(slope, values["K_1"] / values["omega_p"] ** 2, rtol=1e-12)


@pytest.mark.parametrize(
    ("model", "gain", "lag"), [(Rotor(), "K_Omega", "T_rotor"), (YawRateLag(), "K_2", "T_2")]
)
def test_a_lag_falls_to_half_power_and_turns_by_45_degrees_at_its_corner(model, gain, lag):
    """(4.21) and (2.8)."""
    values = model.values(T_delay=0.0)
    corner = 1 / values[lag]
    response = gb.frequency_response(model, values, [1e-6 * corner, corner]).response
    assert_allclose(response, values[gain] * np.array([1, (1 - 1j) / 2]), rtol=1e-5)
    later = gb.frequency_response(model, {**values, "T_delay": 0.02}, [corner]).response
    assert_allclose(later / response[1:], np.exp(-0.02j * corner), rtol=1e-12)


def test_yaw_rate_lead_without_lead_is_the_lag_behind_the_rotor():
    """(2.10) with T_lead = 0 is (2.8) times (2.4) with a gain of one."""
    for values in draws(YawRateLead()):
        lag = response(YawRateLag(), {name: values[name] for name in YawRateLag.parameters})
        rotor = response(Rotor(), {"K_Omega": 1.0, "T_rotor": values["T_rotor"], "T_delay": 0.0})
        assert_allclose(response(YawRateLead(), values | {"T_lead": 0.0}), lag * rotor, rtol=1e-10)


@pytest.mark.parametrize("values", draws(CoupledVelocity(), 5))
def test_coupled_velocity_has_its_printed_transfer_function(values):
    """(2.9), solved by hand: p (s²(s - a1) - g a2) = s (b2 (s - a1) + a2 b1) u."""
    printed = {
        "K_tilde": values["b2"],
        "b1_tilde": values["a2"] * values["b1"] / values["b2"] - values["a1"],
        "a2_tilde": -values["a1"],
        "a0_tilde": -PAPER_G * values["a2"],
        "T_delay": values["T_delay"],
    }
    expected = response(CoupledVelocityTransfer(), printed)
    assert_allclose(response(CoupledVelocity(), values, output="p"), expected, rtol=1e-10)
    derived_quantities_equal(CoupledVelocity(), values, printed)


@pytest.mark.parametrize("values", draws(LaggedCoupledVelocity(), 5))
def test_2_9_behind_the_rotor(values):
    T = values["T_rotor"]
    unlagged = {name: value for name, value in values.items() if name != "T_rotor"}
    for output in ("p", "phi", "v"):
        expected = response(CoupledVelocity(), unlagged, output=output) / (1j * OMEGA * T + 1)
        assert_allclose(
            response(LaggedCoupledVelocity(), values, output=output), expected, rtol=1e-9
        )


def test_2_9_behind_the_rotor_is_4_25_without_damping():
    shared = {"a2": 0.0, "a3": 8.5, "a4": 290.0, "a5": 0.16, "a1": 0.0}
    values = {"a1": -0.16, "a2": -8.5, "b1": 0.0, "b2": 290.0, "T_rotor": 0.048, "T_delay": 0.0042}
    ours = response(LaggedCoupledVelocity(), values, output="phi")
    assert_allclose(ours, response(Tilt(), shared), rtol=1e-9)


def test_the_limits_of_the_mixer():
    """By numpy, for controls within and beyond the limits below (2.3)."""
    random = np.random.default_rng(0)
    controls = random.uniform([0, -1, -1, -1], [1, 1, 1, 1], (500, 4))
    time = np.arange(500.0)
    record = gb.Record(time, dict(zip(LimitedMixer().inputs, controls.T, strict=True)))
    limited = np.clip(controls, [0, -0.5, -0.5, -0.5], [1, 0.5, 0.5, 0.5])
    signs = np.array([[1, -0.5, -0.5, 1], [1, 0.5, 0.5, 1], [1, 0.5, -0.5, -1], [1, -0.5, 0.5, -1]])
    motors = limited @ signs.T
    assert 0.2 < np.mean((motors < 0) | (motors > 1)) < 0.8
    flown = gb.simulate(LimitedMixer(), {}, record)
    assert_allclose(np.column_stack([flown[f"u_{k}"] for k in range(1, 5)]), np.clip(motors, 0, 1))


@pytest.mark.parametrize("values", draws(DampedCoupledVelocity(), 5))
def test_damped_coupled_velocity_has_its_printed_transfer_function(values):
    """(2.11) to (2.12), by hand: p ((s - a11)(s - a22) s - a21 (a12 s + g)) = b2 s (s - a11) u."""
    a11, a12, a21, a22, b2 = values.values()
    printed = {
        "K_tilde": b2,
        "b1_tilde": -a11,
        "a2_tilde": -(a11 + a22),
        "a1_tilde": a11 * a22 - a12 * a21,
        "a0_tilde": -PAPER_G * a21,
    }
    expected = response(DampedCoupledVelocityTransfer(), printed)
    assert_allclose(response(DampedCoupledVelocity(), values, output="p"), expected, rtol=1e-10)
    derived_quantities_equal(DampedCoupledVelocity(), values, printed)


def derived_quantities_equal(model, values, printed):
    for name, formula in model.derived.items():
        assert_allclose(formula(model.values(values)), printed[name], rtol=1e-14)


# --- derivations of section 4


@pytest.mark.parametrize("values", draws(LinearTilt(), 5))
def test_linear_tilt_has_the_transfer_functions_of_the_paper(values):
    """(4.23) with (4.24) and (4.21) gives (4.25), and (4.24) from the angle to the velocity."""
    angle = response(LinearTilt(), values, output="theta")
    assert_allclose(angle, response(Tilt(), values), rtol=1e-10)
    velocity = response(LinearTilt(), values, output="v")
    assert_allclose(velocity, angle * PAPER_G / (1j * OMEGA + values["a5"]), rtol=1e-10)
    derived_quantities_equal(LinearTilt(), values, {"a3_tilde": 9.8065 * values["a3"]})


@pytest.mark.parametrize("values", draws(YawStates(), 5))
def test_yaw_states_have_the_transfer_functions_of_the_paper(values):
    """(4.33) with (4.21) gives (4.34) and, integrated, (4.37)."""
    tilde = {"a1_tilde": values["a1"] * values["K_nu"], "a3_tilde": values["a3"]}
    printed = {name: ({**values, **tilde})[name] for name in YawRate.parameters}
    assert_allclose(
        response(YawStates(), values, output="r"), response(YawRate(), printed), rtol=1e-10
    )
    assert_allclose(
        response(YawStates(), values, output="psi"), response(YawAngle(), printed), rtol=1e-10
    )
    assert_allclose(
        response(YawAngle(), printed) * 1j * OMEGA, response(YawRate(), printed), rtol=1e-12
    )
    derived_quantities_equal(YawStates(), values, tilde)


def shared_with(model, values):
    return {name: value for name, value in values.items() if name in model.parameters}


@pytest.mark.parametrize("values", draws(NonlinearTilt()))
def test_nonlinear_tilt_in_hover_is_linear_tilt_without_drag(values):
    linear = gb.modeling.linearize(LinearTilt(), shared_with(LinearTilt, values) | {"a5": 0.0})
    nonlinear = gb.modeling.linearize(NonlinearTilt(), values)
    for matrix in "ABCD":
        assert_allclose(getattr(nonlinear, matrix), getattr(linear, matrix), rtol=1e-14)
    assert set(nonlinear.point.values()) == {0.0}


@pytest.mark.parametrize("theta", np.radians([5, -5, 30]))
@pytest.mark.parametrize("values", draws(NonlinearTilt()))
def test_nonlinear_tilt_in_forward_flight(values, theta):
    """The trim balances gravity and drag; the drag's slope is 2 C_x |v|, that of g tan θ is g / cos² θ."""
    speed = np.sqrt(PAPER_G * np.tan(abs(theta)) / values["C_x"])
    v = np.sign(theta) * speed
    u = (values["a1"] * theta + values["a3"] * v) / values["a4"]
    system = gb.modeling.linearize(NonlinearTilt(), values, at={"theta": theta})
    wanted = {"v": v, "q": 0.0, "theta": theta, "rotor": u, "u": u}
    assert_allclose(
        [system.point[name] for name in wanted], list(wanted.values()), rtol=1e-9, atol=1e-12
    )
    linear = gb.modeling.linearize(LinearTilt(), shared_with(LinearTilt, values))
    A = linear.A.copy()
    A[0, 0], A[0, 2] = -2 * values["C_x"] * speed, PAPER_G / np.cos(theta) ** 2
    assert_allclose(system.A, A, rtol=1e-9)
    assert_allclose(system.B, linear.B, rtol=1e-14)


ROTOR_POLE = -1 / 0.048
PUBLISHED = {  # parameters, and the gain, zero and poles of the transfer function printed for them
    "(4.29)": (
        Tilt,
        [-1.28, 1.86, 73.07, 286.6],
        56.67 / 0.198,
        [-1 / 0.198, *np.roots([1, -3.04, 14.4])],
    ),
    "(4.30)": (
        Tilt,
        [-14.61, 2.97, 83.06, 295.5],
        42.91 / 0.145,
        [-1 / 0.145, *np.roots([1, -3.75, 11.7])],
    ),
    "(4.32)": (Tilt, [-34.01, 3.41, 26.38, 241.9], 30.05 / 0.124, [-1 / 0.124, 3.79, 0.685]),
    "(4.36)": (YawRate, [-1875, 352.6, 992.0, 5.62], 992.0, [-358, -0.296]),
    "(4.37)": (YawAngle, [-1875, 352.6, 992.0, 5.62], 992.0, [-358, -0.296, 0]),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_parameters_give_the_published_gain_and_poles(name):
    """The paper prints its estimates twice, as parameters and factored; they agree to the digits printed."""
    model, numbers, gain, poles = PUBLISHED[name]
    names = ["a1", "a2", "a3", "a4"] if model is Tilt else ["a1_tilde", "a2", "a3_tilde", "a4"]
    values = dict(zip(names, numbers, strict=True))
    if model is Tilt:
        values["a3"] /= PAPER_G
    for parameter, value in values.items():
        low, high = model.parameters[parameter].bounds
        assert low < value < high
    form = gb.modeling.rational(model(), values)
    assert form.delay == 0.0042
    found = np.sort_complex(np.roots(form.denominator))
    assert_allclose(found, np.sort_complex([ROTOR_POLE, *poles]), rtol=1e-2, atol=1e-10)
    assert_allclose(form.numerator[0] / form.denominator[0], gain / 0.048, rtol=3e-3)


# --- polynomials

EXPANDED = {  # (3.18) to (3.20): gain, zero, first-order factors, quadratic factor, integrator
    "(3.18)": (58.65, -0.304, (0.050, 0.193), (1, -3.44, 13.8), False),
    "(3.19)": (49.39, 0.156, (0.046, 0.181), (1, -3.79, 12.9), False),
    "(3.20)": (1294, -10.93, (0.834,), (1, 28.9, 1036), True),
}


@pytest.mark.parametrize("name", EXPANDED)
def test_polynomial_holds_the_least_squares_fits_inside_its_start_box(name):
    gain, zero, lags, quadratic, integrator = EXPANDED[name]
    s = 1j * OMEGA
    factored = gain * (s - zero) / np.polyval(quadratic, s) / (s if integrator else 1)
    denominator = np.poly1d(quadratic) * np.poly1d([1, 0] if integrator else [1])
    for T in lags:
        factored, denominator = factored / (T * s + 1), denominator * np.poly1d([1, 1 / T])
    numerator = np.poly1d([1, -zero]) * (gain / np.prod(lags))
    model = Polynomial(4, 1, integrator=integrator)
    values = {p: (numerator if p[0] == "b" else denominator)[int(p[1:])] for p in model.parameters}
    assert_allclose(response(model, values), factored, rtol=1e-12)
    for p, value in values.items():
        assert model.parameters[p].box[0] < value < model.parameters[p].box[1]


@pytest.mark.parametrize(
    ("n", "m", "integrator", "names"),
    [
        (4, 1, False, "b0 b1 a0 a1 a2 a3"),
        (4, 1, True, "b0 b1 a1 a2 a3"),
        (1, 0, True, "b0"),
        (2, 0, False, "b0 a0 a1"),
    ],
)
def test_polynomial_names_its_coefficients(n, m, integrator, names):
    model = Polynomial(n, m, integrator)
    assert list(model.parameters) == names.split()
    assert model.label == f"Polynomial({n}, {m}{', integrator' if integrator else ''})"
    form = gb.modeling.rational(model)
    assert (len(form.denominator) - 1, len(form.numerator) - 1) == (n, m)
    assert (form.denominator[-1] == 0) is integrator


def test_polynomial_units_count_the_powers_of_a_second():
    parameters = Polynomial(12, 2).parameters
    assert [parameters[p].unit for p in ("a11", "a10", "a2", "b2", "b0")] == [
        "1/s",
        "1/s²",
        "1/s¹⁰",
        "1/s¹⁰",
        "1/s¹²",
    ]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"n": 2, "m": 2}, r"m = 2 is not below n = 2: .* Lower m or raise n"),
        (
            {"n": 0, "m": 0},
            r"n = 0 is not the order of a polynomial: give an integer of at least 1",
        ),
        ({"n": 2.5, "m": 1}, r"n = 2\.5 is not the order"),
        ({"n": "4", "m": 1}, r"n = '4' is not the order"),
        ({"n": True, "m": 0}, r"n = True is not the order"),
        (
            {"n": 3, "m": -1},
            r"m = -1 is not the order of a polynomial: give an integer of at least 0",
        ),
        (
            {"radius": 10.0, "starts": 20.0},
            r"starts = 20\.0 and radius = 10\.0 must be finite with 0 < starts",
        ),
        ({"radius": np.inf}, r"radius = inf must be finite"),
        ({"starts": np.nan}, r"starts = nan .* must be finite"),
        ({"starts": 0.0}, r"0 < starts <= radius"),
    ],
)
def test_polynomial_refuses(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        Polynomial(**arguments)
