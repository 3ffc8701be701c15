"""The numbers of `docs/the_paper.md`, each computed anew."""

import itertools
import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benchmark_module import benchmark
from scipy.optimize import minimize
from scipy.stats import t as t_distribution

import greybox as gb
from greybox.models.multirotor import Mixer, Torques
from greybox.models.tilt import PAPER_G, Tilt
from greybox.problems import (
    nanobench_drag,
    pitch_5deg,
    pitch_hover,
    pitch_hover_ls,
    pitch_moment,
    pitch_operating_points,
    roll_hover,
    roll_hover_ls,
    rotors,
    rotors_mended,
    yaw_hover,
    yaw_hover_ls,
)

ROOT = Path(__file__).parents[2]
PAGE = " ".join((ROOT / "docs" / "the_paper.md").read_text(encoding="utf-8").split())
ROUNDING = {"K_Omega": 0.5, "T_rotor": 5e-4, "T_delay": 5e-5}
TILT_ROUNDING = {"a1": 0.005, "a2": 0.005, "a3": 0.005 / PAPER_G, "a4": 0.05}


def fit(problem, starts=2, **options):
    return gb.fit(problem, starts=starts, progress=False, profiles=False, **options)


@pytest.mark.parametrize(
    ("module", "equation", "half"),
    [
        (rotors_mended, "(4.22)", ROUNDING),
        (pitch_5deg, "(4.31)", TILT_ROUNDING),
        (pitch_hover, "(4.28)", TILT_ROUNDING),
        (roll_hover, "(4.27)", TILT_ROUNDING),
    ],
)
def test_published_estimates_and_minima(module, equation, half):
    published = module.published["values"]
    box = {name: (published[name] - h, published[name] + h) for name, h in half.items()}
    best = fit(module.problem())
    rounded = fit(module.problem().with_(bounds=box), starts=[published])
    name, errors = max(
        ((n, abs(best.estimate[n] - v) / best.standard_error[n]) for n, v in published.items()),
        key=lambda pair: pair[1],
    )
    costs = (gb.cost(module.problem(), published), rounded.cost, best.cost)
    row = " | ".join([*(f"{cost:.4f}" for cost in costs), f"{name}, {errors:.1f} standard errors"])
    assert re.search(rf"\| {re.escape(equation)} [^|]*\| Table \d\.\d \| {re.escape(row)} \|", PAGE)


def test_rounded_constants_do_not_excuse_the_estimate_of_roll():
    published = roll_hover.published["values"]
    excess = []
    for T, delay, a5 in itertools.product((0.0475, 0.0485), (0.00415, 0.00425), (0.155, 0.165)):
        fixed = {"T_rotor": T, "T_delay": delay, "a5": a5}
        stated = gb.Problem(Tilt(), roll_hover.data(), fixed=fixed)
        excess.append(gb.cost(stated, published) - fit(stated).cost)
    assert min(excess) > 0.0495
    best = fit(roll_hover.problem())
    assert f"to {best.estimate['a1']:.2f} ± {best.standard_error['a1']:.2f}" in PAGE


def test_the_linear_equations_do_not_minimize_the_criterion():
    modules = (roll_hover_ls, pitch_hover_ls, yaw_hover_ls)
    costs = [gb.cost(m.problem(), m.published["values"]) for m in modules]
    assert "They cost {:.3f}, {:.3f} and {:.3f},".format(*costs) in PAGE
    # The tests of the problems hold these minima against fits.
    assert "reach {:.3f}, {:.3f} and {:.3f}.".format(*(m.minimum for m in modules)) in PAGE


def test_errors_that_are_not_independent():
    widths = {}
    for module in (roll_hover, pitch_hover, pitch_5deg, yaw_hover):
        data = module.data()
        unstated = gb.FrequencyResponse(
            data.omega, data.response, input=data.input, output=data.output, name=data.name
        )
        fits = [fit(module.problem()), fit(gb.Problem(module.problem().model, unstated))]
        low, high = zip(*(np.transpose([*f.interval(0.95).values()]) for f in fits), strict=True)
        ratio = (high[1] - low[1]) / (high[0] - low[0])
        widths[data.name] = ratio[np.isfinite(ratio)]
    assert widths.pop("roll hover") == pytest.approx(1.0)
    wider = np.concatenate([*widths.values()])
    assert f"are {wider.min():.1f} to {wider.max():.1f} times as wide" in PAGE
    assert f"± {t_distribution.ppf(0.975, 2 * 10 - 4):.1f} standard errors" in PAGE


def test_one_sign_and_the_delays_of_the_rotors():
    values = rotors.published["values"]
    costs = [gb.cost(rotors.problem(mended=m), values) for m in (False, True)]
    assert "(4.22) costs {:.4f}, with the other {:.4f}.".format(*costs) in PAGE
    both = [fit(m.problem()) for m in (rotors, rotors_mended)]
    assert {f"{found.estimate['T_rotor']:.4f}" for found in both} == {"0.0473"}
    first, second = both[1].misfit.likely[:2]
    assert "T_delay that is smaller" in first.text
    assert "'rotor 2'" in first.text
    assert "T_delay that is larger" in second.text
    assert "'rotor 4'" in second.text


def test_the_digits_of_the_table_leave_the_zero_of_yaw_open():
    yaw = yaw_hover.data()
    rows = (ROOT / "problems" / "data" / "table_3_1.csv").read_text(encoding="utf-8").split()[1:]
    cells = [row.split(",")[5:7] for row in rows]
    half = [[0.5 * 10.0 ** -len(c.split(".")[1]) for c in row] for row in cells if row[0]]
    half = np.array(half)
    random, zeros = np.random.default_rng(0), []
    for errors in [np.zeros_like(half), *(random.uniform(-half, half) for _ in range(300))]:
        response = yaw.response + errors[:, 0] + 1j * errors[:, 1]
        found = gb.regression.levy(replace(yaw, response=response), 4, 1, integrator=True)
        zeros.append(found.zeros[0].real)
    assert f"gives {zeros[0]:.1f} by" in PAGE
    assert np.percentile(zeros, [2.5, 97.5]) == pytest.approx([-13.5, -10.5], abs=0.2)


def test_yaw_has_three_parameters():
    found = fit(yaw_hover.problem(), starts=20)
    assert f"a4 = {found.estimate['a4']:.2f} ± {found.standard_error['a4']:.2f}" in PAGE
    assert f"minimum is {found.cost:.4f}." in PAGE
    for name in ("a1_tilde", "a2", "a3_tilde"):
        assert found.standard_error[name] > abs(found.estimate[name])

    omega, measured = yaw_hover.data().omega, yaw_hover.data().response
    s = 1j * omega

    def cost(p):  # the fast pole at infinity, written by hand
        rate = p[1] * (s + p[2]) / (s + p[2] + p[0])
        return np.sum(np.abs(rate / (0.048 * s + 1) * np.exp(-0.0042 * s) / s / measured - 1))

    values = minimize(cost, [-5.05, 2.87, 5.57], method="Nelder-Mead", options={"xatol": 1e-6})
    assert f"costs {values.fun:.4f} instead of {found.cost:.4f}" in PAGE


def test_the_factor_below_2_3():
    """Derivatives of (2.3), without a formula of the paper in between."""
    K_tau, K_Omega, hover = 2e-6, 1033.0, 600.0
    signs = np.array([-1, 1, 1, -1])
    at = {f"Omega_{k}": hover for k in (1, 2, 3, 4)}
    slopes = [
        gb.frequency_response(
            Torques(), {"K_tau": K_tau}, [1.0], input=f"Omega_{k}", output="tau_phi", at=at
        )
        .response[0]
        .real
        for k in (1, 2, 3, 4)
    ]
    assert slopes @ signs == pytest.approx(8 * K_tau * hover)
    mixed = [
        gb.frequency_response(Mixer(), None, [1.0], input="u_phi", output=f"u_{k}").response[0].real
        for k in (1, 2, 3, 4)
    ]
    assert K_Omega * np.dot(slopes, mixed) == pytest.approx(4 * K_tau * hover * K_Omega)


def test_one_operating_point_and_the_other():
    separate = fit(pitch_moment.separate())
    terms = [fit(pitch_moment.problem(t)) for t in (("b_vv", "b_vtheta"), pitch_moment.TERMS)]
    assert f"costs {pitch_operating_points.minimum:.2f} on Tables" in PAGE
    assert f"two separate fits cost {separate.cost:.2f}." in PAGE
    assert (
        "costs {:.2f}, with $|v| \\tau$ in addition {:.2f}.".format(*(t.cost for t in terms))
        in PAGE
    )

    between = gb.validation.differences(fit(pitch_hover.problem()), fit(pitch_5deg.problem()))
    assert str(between).startswith("a1, a3 and a4 differ beyond the errors")

    fall = PAPER_G * math.tan(math.radians(5))
    assert f"{2 * fall / 0.16:.1f} m/s if the drag is quadratic" in PAGE
    assert f"{fall / 0.16:.1f} m/s with the linear drag" in PAGE


@cache
def simulated_study():
    """Return the study of operating points and its truth."""
    study = benchmark("operating_points")
    explained = fit(pitch_moment.problem(), starts=1)
    return study, {name: explained.estimate[name] for name in study.TiltMomentAt().parameters}


def test_where_the_linear_structure_stops():
    study, truth = simulated_study()
    hover, slow, slope = (study.measured(truth, angle).response for angle in (0.0, 0.1, 2.5))
    assert f"wrong by {study.relative(hover, slow):.0f} % at 0.1°" in PAGE
    assert f"which is {study.speed(math.radians(0.1)):.1f} m/s" in PAGE
    assert f"and by {study.relative(hover, slope):.0f} % at 2.5°" in PAGE

    lines = (ROOT / "benchmarks" / "results" / "operating_points.txt").read_text(encoding="utf-8")
    assert re.findall(r"^(\w+) .* (yes|no)$", lines, re.MULTILINE)[:3] == [
        ("speed", "yes"),
        ("angle", "no"),
        ("thrust", "no"),
    ]
    sines, all_tests = (float(t) for t in re.findall(r":\n +(\d+) s ", lines))
    assert all_tests < sines / 3


@pytest.mark.usefixtures("unjudged")
def test_two_angles_cannot_tell_speed_angle_and_thrust_apart():
    study, truth = simulated_study()
    responses = {angle: study.measured(truth, angle) for angle in (0.0, 5.0)}
    costs = [study.joint(variable, responses, 1, starts=1).cost for variable in study.SCHEDULED]
    assert np.max(costs) < 1e-3  # no errors were added
    more = responses | {20.0: study.measured(truth, 20.0)}
    speed, thrust = (study.joint(v, more, 1, starts=1).cost for v in ("speed", "thrust"))
    assert speed < 100 < thrust


@pytest.mark.usefixtures("unjudged")
def test_the_drag_of_real_flights():
    linear, both = (fit(nanobench_drag.problem(**f), starts=1) for f in ({"C_x": 0.0}, {}))
    assert f"linear, {linear.estimate['a5']:.3f} 1/s" in PAGE
    assert f"(p = {gb.validation.nested_test(linear, both).p_value:.2f})" in PAGE
    lines = (ROOT / "benchmarks" / "results" / "nanobench.txt").read_text(encoding="utf-8")
    assert lines.startswith("78 flights")
    for a5, C_x in re.findall(r"drag, both: a5 ([\d.]+) ± \S+ C_x ([\d.]+)", lines):
        assert float(C_x) / float(a5) == pytest.approx(0.117, abs=0.01)
