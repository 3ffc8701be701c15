"""Answers of other tools' suites and of published benchmarks, refitted.

Sources of data and answers:

- COPS: Dolan, Moré, Munson (2004), Benchmarking optimization software with COPS 3.0, problems gas
  oil, methanol and alpha-pinene; the numbers as in COPSBenchmark.jl (MIT license), whose tests hold
  the costs.
- Rooney and Biegler (2001), AIChE Journal 47, 1794; data: Marske (1967) in Bates and Watts (1988),
  A1.4; the answers are those of the tests of parmest in Pyomo (BSD license).
- Boehm et al. (2014), J. Proteome Res. 13, 5685, Bruno et al. (2016), J. Exp. Bot. 67, 5993, and
  Crauste et al. (2017), Cell Systems 4, 306, as in the PEtab benchmark collection (BSD license); likelihoods: Hass et al. (2019), Bioinformatics
  35, 3073.
"""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import minimize

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


def squares(fit):
    """Return the sum of squared residuals of all outputs."""
    part = fit.records[0]
    return sum(np.nansum(part.residual(name) ** 2) for name in part.outputs)


def least_squares(model, time, signals, initial, starts=1):
    """Fit plain least squares from known initial states."""
    criterion = gb.OutputError(noise=dict.fromkeys(signals, 1.0), initial=initial)
    problem = gb.Problem(model, gb.Record(time, signals), criterion)
    return gb.fit(problem, starts, progress=False)


# --- COPS


class GasOil(gb.StateSpace):
    """Catalytic cracking of gas oil."""

    states = outputs = ("y1", "y2")
    inputs = ()
    theta1 = gb.Parameter(1.0, bounds=(0, 100))
    theta2 = gb.Parameter(1.0, bounds=(0, 100))
    theta3 = gb.Parameter(1.0, bounds=(0, 100))

    def derivative(self, x, u, p):
        return (
            -(p.theta1 + p.theta3) * x.y1**2,
            p.theta1 * x.y1**2 - p.theta2 * x.y2,
        )

    def output(self, x, u, p):
        return (x.y1, x.y2)


def test_gas_oil():
    # fmt: off
    time = [0, 0.025, 0.05, 0.075, 0.1, 0.125, 0.15, 0.175, 0.2, 0.225, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.65, 0.75, 0.85, 0.95]
    y1 = [1, 0.8105, 0.6208, 0.5258, 0.4345, 0.3903, 0.3342, 0.3034, 0.2735, 0.2405, 0.2283, 0.2071, 0.1669, 0.1530, 0.1339, 0.1265, 0.1200, 0.0990, 0.0870, 0.0770, 0.0690]
    y2 = [0, 0.2000, 0.2886, 0.3010, 0.3215, 0.3123, 0.2716, 0.2551, 0.2258, 0.1959, 0.1789, 0.1457, 0.1198, 0.0909, 0.0719, 0.0561, 0.0460, 0.0280, 0.0190, 0.0140, 0.0100]
    # fmt: on
    fit = least_squares(GasOil(), time, {"y1": y1, "y2": y2}, {"y1": 1.0, "y2": 0.0})
    assert squares(fit) == pytest.approx(5.2366e-3, abs=1e-7)


class Methanol(gb.StateSpace):
    """Methanol to hydrocarbons."""

    states = outputs = ("y1", "y2", "y3")
    inputs = ()
    theta1 = gb.Parameter(1.0, bounds=(0, 100))
    theta2 = gb.Parameter(1.0, bounds=(0, 100))
    theta3 = gb.Parameter(1.0, bounds=(0, 100))
    theta4 = gb.Parameter(1.0, bounds=(0, 100))
    theta5 = gb.Parameter(1.0, bounds=(0, 100))

    def derivative(self, x, u, p):
        y1, y2 = x.y1, x.y2
        share = p.theta1 * y1 / ((p.theta2 + p.theta5) * y1 + y2)
        return (
            -(2 * p.theta2 + p.theta3 + p.theta4) * y1 + share * y2,
            share * (p.theta2 * y1 - y2) + p.theta3 * y1,
            share * (y2 + p.theta5 * y1) + p.theta4 * y1,
        )

    def output(self, x, u, p):
        return (x.y1, x.y2, x.y3)


def test_methanol():
    # fmt: off
    time = [0, 0.05, 0.065, 0.08, 0.123, 0.233, 0.273, 0.354, 0.397, 0.418, 0.502, 0.553, 0.681, 0.75, 0.916, 0.937, 1.122]
    y1 = [1, 0.7085, 0.5971, 0.5537, 0.3684, 0.1712, 0.1198, 0.0747, 0.0529, 0.0415, 0.0261, 0.0208, 0.0085, 0.0053, 0.0019, 0.0018, 0.0006]
    y2 = [0, 0.1621, 0.1855, 0.1989, 0.2845, 0.3491, 0.3098, 0.3576, 0.3347, 0.3388, 0.3557, 0.3483, 0.3836, 0.3611, 0.3609, 0.3485, 0.3698]
    y3 = [0, 0.0811, 0.0965, 0.1198, 0.1535, 0.2097, 0.2628, 0.2467, 0.2884, 0.2757, 0.3167, 0.2954, 0.2950, 0.2937, 0.2831, 0.2846, 0.2899]
    # fmt: on
    initial = {"y1": 1.0, "y2": 0.0, "y3": 0.0}
    fit = least_squares(Methanol(), time, {"y1": y1, "y2": y2, "y3": y3}, initial)
    assert squares(fit) == pytest.approx(9.02229e-3, abs=1e-7)


class Pinene(gb.StateSpace):
    """Thermal isomerization of alpha-pinene."""

    states = outputs = ("y1", "y2", "y3", "y4", "y5")
    inputs = ()
    theta1 = gb.Parameter(1e-5, bounds=(0, 1e-2), unit="1/s")
    theta2 = gb.Parameter(1e-5, bounds=(0, 1e-2), unit="1/s")
    theta3 = gb.Parameter(1e-5, bounds=(0, 1e-2), unit="1/s")
    theta4 = gb.Parameter(1e-5, bounds=(0, 1e-2), unit="1/s")
    theta5 = gb.Parameter(1e-5, bounds=(0, 1e-2), unit="1/s")

    def derivative(self, x, u, p):
        return (
            -(p.theta1 + p.theta2) * x.y1,
            p.theta1 * x.y1,
            p.theta2 * x.y1 - (p.theta3 + p.theta4) * x.y3 + p.theta5 * x.y5,
            p.theta3 * x.y3,
            p.theta4 * x.y3 - p.theta5 * x.y5,
        )

    def output(self, x, u, p):
        return (x.y1, x.y2, x.y3, x.y4, x.y5)


def test_alpha_pinene():
    time = [0, 1230.0, 3060.0, 4920.0, 7800.0, 10680.0, 15030.0, 22620.0, 36420.0]
    measured = {
        "y1": [88.35, 76.4, 65.1, 50.4, 37.5, 25.9, 14.0, 4.5],
        "y2": [7.3, 15.6, 23.1, 32.9, 42.7, 49.1, 57.4, 63.1],
        "y3": [2.3, 4.5, 5.3, 6.0, 6.0, 5.9, 5.1, 3.8],
        "y4": [0.4, 0.7, 1.1, 1.5, 1.9, 2.2, 2.6, 2.9],
        "y5": [1.75, 2.8, 5.8, 9.3, 12.0, 17.0, 21.0, 25.7],
    }
    signals = {name: [math.nan, *values] for name, values in measured.items()}
    initial = dict.fromkeys(signals, 0.0) | {"y1": 100.0}
    fit = least_squares(Pinene(), time, signals, initial)
    assert squares(fit) == pytest.approx(19.8721, abs=1e-4)


# --- parmest


class RooneyBiegler(gb.StateSpace):
    """Biochemical oxygen demand, y = asymptote (1 - exp(-rate_constant hour))."""

    states, inputs, outputs = (), ("hour",), ("y",)
    asymptote = gb.Parameter(15.0, bounds=(1, 100))
    rate_constant = gb.Parameter(0.5, bounds=(0.01, 10))

    def output(self, x, u, p):
        return (p.asymptote * (1 - gb.exp(-p.rate_constant * u.hour)),)


def test_rooney_biegler():
    data = {"hour": [1, 2, 3, 4, 5, 7], "y": [8.3, 10.3, 19.0, 16.0, 15.6, 19.8]}
    fit = gb.fit(gb.Problem(RooneyBiegler(), gb.Record(None, data)), 1, progress=False)
    assert fit.estimate["asymptote"] == pytest.approx(19.1426, abs=1e-4)
    assert fit.estimate["rate_constant"] == pytest.approx(0.5311, abs=1e-4)
    # parmest's covariance by first derivatives.
    expected = [[6.229612, -0.432265], [-0.432265, 0.041242]]
    assert_allclose(fit.covariance, expected, rtol=1e-4)


class RooneyBieglerOde(gb.StateSpace):
    """The same as a differential equation."""

    states = outputs = ("y",)
    inputs = ()
    asymptote = gb.Parameter(15.0, bounds=(1, 100))
    rate_constant = gb.Parameter(0.5, bounds=(0.01, 10))

    def derivative(self, x, u, p):
        return (p.rate_constant * (p.asymptote - x.y),)

    def output(self, x, u, p):
        return (x.y,)


def test_rooney_biegler_as_a_differential_equation():
    record = gb.Record([0, 1, 2, 3, 4, 5, 7], {"y": [math.nan, 8.3, 10.3, 19.0, 16.0, 15.6, 19.8]})
    problem = gb.Problem(RooneyBieglerOde(), record, gb.OutputError(initial={"y": 0.0}))
    fit = gb.fit(problem, 1, progress=False)
    assert fit.estimate["asymptote"] == pytest.approx(19.1426, abs=1e-3)
    assert fit.estimate["rate_constant"] == pytest.approx(0.5311, abs=1e-4)


# --- the PEtab collection


def rate(start, low=1e-5, high=1e5):
    """Return a parameter over decades."""
    return gb.Parameter(start, bounds=(low, high), scale="log")


class Boehm(gb.StateSpace):
    """Phosphorylation, import and export of STAT5A and STAT5B after stimulation by Epo."""

    states = ("A", "B", "pAB", "pAA", "pBB", "nAA", "nAB", "nBB", "epo")
    inputs, outputs = (), ("pA", "pB", "rA")
    degradation = rate(0.027)
    k_phos = rate(15766.0)
    k_imp_homo = rate(97749.0)
    k_imp_hetero = rate(0.01637)
    k_exp_homo = rate(0.00617)
    k_exp_hetero = rate(1.1e-5)

    def derivative(self, x, u, p):
        volumes = 0.45 / 1.4  # of nucleus and cytoplasm
        aa, ab, bb = (x.epo * p.k_phos * pair for pair in (x.A**2, x.A * x.B, x.B**2))
        out_aa, out_bb = p.k_exp_homo * x.nAA, p.k_exp_homo * x.nBB
        out_ab = p.k_exp_hetero * x.nAB
        return (
            -2 * aa - ab + volumes * (2 * out_aa + out_ab),
            -2 * bb - ab + volumes * (2 * out_bb + out_ab),
            ab - p.k_imp_hetero * x.pAB,
            aa - p.k_imp_homo * x.pAA,
            bb - p.k_imp_homo * x.pBB,
            p.k_imp_homo * x.pAA / volumes - out_aa,
            p.k_imp_hetero * x.pAB / volumes - out_ab,
            p.k_imp_homo * x.pBB / volumes - out_bb,
            -p.degradation * x.epo,
        )

    def output(self, x, u, p):
        c = 0.107  # specificity of the antibody
        A, B = c * (x.A + 2 * x.pAA) + x.pAB, (1 - c) * (x.B + 2 * x.pBB) + x.pAB
        return (
            100 * (x.pAB + 2 * c * x.pAA) / A,
            100 * (x.pAB + 2 * (1 - c) * x.pBB) / B,
            100 * A / (A + B),
        )


def test_boehm():
    """The minimum lies on two bounds; the standard deviations are estimated."""
    # fmt: off
    time = [0, 2.5, 5, 10, 15, 20, 30, 40, 50, 60, 80, 100, 120, 160, 200, 240]
    signals = {
        "pA": [7.90107299873911, 66.3634939682528, 81.1713239165337, 94.7303080627876, 95.1164830493244, 91.44171655392, 91.2570992263545, 93.672297840992, 88.754232823019, 85.2697032178279, 81.1323953369608, 76.135928475796, 65.2480591250229, 42.5996587097166, 25.1577975445976, 15.4301823994994],
        "pB": [4.59653334288927, 29.6345459874189, 46.0438064695701, 81.9747336191685, 80.5716092952489, 79.0357196371442, 75.6723803658298, 71.6247198618303, 69.0628632755742, 67.1473843168934, 60.8994762938824, 54.8092577721492, 43.9812899778025, 29.7714581636675, 20.089016562771, 10.961845166698],
        "rA": [14.7231682180584, 33.762342293107, 36.7998512942493, 49.7176022859654, 46.9281200952955, 47.8365745550135, 46.9287272497385, 40.5977529351181, 43.783663885071, 44.4573876523855, 41.3271592618297, 41.0627332148332, 39.2358300289377, 36.6194605442418, 34.8937144010561, 32.2110771608676],
    }
    # fmt: on
    total = 207.6
    initial = dict.fromkeys(Boehm.states, 0.0)
    initial |= {"A": 0.693 * total, "B": (1 - 0.693) * total, "epo": 1.25e-7}
    problem = gb.Problem(Boehm(), gb.Record(time, signals), gb.OutputError(initial=initial))
    assert gb.fit(problem, 1, progress=False).cost == pytest.approx(138.22197, abs=1e-4)


class Crauste(gb.StateSpace):
    """Immune cells and a pathogen; the measurements are divided by their own standard deviations."""

    states = ("naive", "early", "late", "memory", "pathogen")
    inputs = ("sd_naive", "sd_early", "sd_late", "sd_memory")
    outputs = ("y_naive", "y_early", "y_late", "y_memory")
    delta_EL = rate(0.517945937424841)
    delta_LM = rate(0.022580636941607)
    delta_NE = rate(0.011930787933602)
    mu_EE = rate(3.91359465940441e-05)
    mu_LE = rate(1.00000000000007e-10, 1e-10)
    mu_LL = rate(8.11520130499257e-06, 1e-10)
    mu_N = rate(0.739907304399124)
    mu_P = rate(1.00000003522094e-05)
    mu_PE = rate(1.41248724084794e-10, 1e-10)
    mu_PL = rate(3.63403086241783e-05)
    rho_E = rate(0.507415649004014)
    rho_P = rate(0.126382292625502)

    def derivative(self, x, u, p):
        N, E, L, P = x.naive, x.early, x.late, x.pathogen
        return (
            -N * p.mu_N - N * P * p.delta_NE,
            N * P * p.delta_NE + E * P * p.rho_E - E**2 * p.mu_EE - E * p.delta_EL,
            E * p.delta_EL - L**2 * p.mu_LL - E * L * p.mu_LE - L * p.delta_LM,
            L * p.delta_LM,
            P**2 * p.rho_P - E * P * p.mu_PE - L * P * p.mu_PL - P * p.mu_P,
        )

    def output(self, x, u, p):
        return (
            x.naive / u.sd_naive,
            x.early / u.sd_early,
            x.late / u.sd_late,
            x.memory / u.sd_memory,
        )


# Time in days: measured cells and their standard deviations.
CELLS = {
    "naive": {4: (459, 290), 6: (74, 64)},
    "early": {
        4: (386, 266),
        6: (1172, 526),
        7: (47470, 23855),
        8: (175825, 19722),
        13: (4911, 3048),
        15: (7417, 2924),
        22: (3359, 1540),
    },
    "late": {
        6: (888, 182),
        7: (4577, 1976),
        8: (32860, 4105),
        13: (46727, 23601),
        15: (27586, 6841),
        22: (13650, 7266),
        28: (3936, 2705),
    },
    "memory": {
        8: (289, 80),
        13: (9564, 4206),
        15: (15631, 5745),
        22: (41744, 15987),
        28: (32705, 7909),
    },
}


def test_crauste_from_the_published_point():
    """Without its cells the pathogen is infinite at 7.9 days: every digit of the point counts."""
    time = [0, 4, 6, 7, 8, 13, 15, 22, 28]
    signals = {}
    for name, measured in CELLS.items():
        pairs = [measured.get(day, (math.nan, 1.0)) for day in time]
        signals[f"y_{name}"] = [value / deviation for value, deviation in pairs]
        signals[f"sd_{name}"] = [deviation for _, deviation in pairs]
    hold = dict.fromkeys(Crauste.inputs, math.inf)
    initial = dict.fromkeys(Crauste.states, 0.0) | {"naive": 8090.0, "pathogen": 1.0}
    criterion = gb.OutputError(noise=dict.fromkeys(Crauste.outputs, 1.0), initial=initial)
    problem = gb.Problem(Crauste(), gb.Record(time, signals, hold=hold), criterion)

    # The likelihood of the measurements themselves.
    scales = sum(math.log(sd) for cells in CELLS.values() for _, sd in cells.values())
    method = gb.MultipleShooting(integrator=gb.Radau())
    assert gb.cost(problem, {}, method) + scales == pytest.approx(190.965, abs=0.002)
    fit = gb.fit(problem, 1, method=method, progress=False)
    assert fit.converged
    assert fit.cost + scales == pytest.approx(190.965, abs=0.002)


class Bruno(gb.StateSpace):
    """Carotenoids cleaved by an enzyme; measurements are divided by their standard deviations."""

    states = ("bcar", "bcry", "b10", "ohb10", "zea")
    inputs = tuple(f"sd_{name}" for name in states)
    outputs = tuple(f"y_{name}" for name in states)
    kb1 = rate(0.02)
    kb2 = rate(0.005)
    kc1 = rate(0.002)
    kc2 = rate(0.007)
    kc4 = rate(0.006)
    k5 = rate(0.003)
    szea = rate(0.5)
    begin = rate(3.0)
    reactions: dict[str, float | str] = {}  # what each rate is multiplied with: 0, 1 or szea

    def derivative(self, x, u, p):
        kb1, kb2, kc1, kc2, kc4, k5 = (
            getattr(p, name) * (p.szea if factor == "szea" else factor)
            for name, factor in self.reactions.items()
        )
        return (
            -kb1 * x.bcar,
            -(kc1 + kc2) * x.bcry,
            kb1 * x.bcar - kb2 * x.b10 + kc1 * x.bcry,
            kc2 * x.bcry - kc4 * x.ohb10 + k5 * x.zea,
            -k5 * x.zea,
        )

    def output(self, x, u, p):
        return tuple(getattr(x, name) / getattr(u, f"sd_{name}") for name in self.states)


# The substrate of each experiment, and the factors of kb1, kb2, kc1, kc2, kc4 and k5.
EXPERIMENTS = {
    1: ("b10", (0, 1, 1, 0, 1, 0)),
    2: ("bcar", (1, 1, 0, 0, 0, 1)),
    3: ("bcar", ("szea",) * 6),
    4: ("bcry", (0, 1, 1, 1, 1, 1)),
    5: ("ohb10", (0, 1, 0, 0, 1, 0)),
    6: ("zea", (0, 0, 0, 0, "szea", "szea")),
}

# By experiment and substance: minutes, measurement, its standard deviation.
BRUNO = {
    (1, "b10"): [
        (5, 3.973385, 0.406451),
        (15, 3.976118, 0.406728),
        (30, 3.12959, 0.320749),
        (60, 3.131418, 0.320935),
        (90, 3.105543, 0.31831),
        (120, 2.279702, 0.234682),
        (180, 1.321613, 0.138555),
    ],
    (2, "bcar"): [
        (15, 3.83496, 0.251006),
        (30, 2.68932, 0.179664),
        (45, 2.12541, 0.145321),
        (60, 1.55414, 0.111703),
        (90, 0.90185, 0.076761),
        (120, 0.62496, 0.064455),
        (180, 0.30276, 0.054089),
    ],
    (2, "b10"): [
        (15, 0.87947, 0.110017),
        (30, 1.61775, 0.194075),
        (45, 2.0221, 0.240978),
        (60, 2.51711, 0.298703),
        (90, 2.24951, 0.267467),
        (120, 2.46923, 0.29311),
        (180, 2.09599, 0.249578),
    ],
    (3, "bcar"): [
        (15, 2.792, 0.161073),
        (30, 2.51, 0.146065),
        (45, 2.101, 0.124582),
        (60, 1.917, 0.115071),
        (90, 1.598, 0.098916),
        (120, 1.135, 0.076702),
        (180, 0.824, 0.063285),
    ],
    (3, "b10"): [
        (15, 0.573, 0.066702),
        (30, 0.849, 0.092359),
        (45, 0.968, 0.10382),
        (60, 1.212, 0.127709),
        (90, 1.411, 0.147436),
        (120, 1.612, 0.167498),
        (180, 2.168, 0.223405),
    ],
    (4, "bcry"): [
        (15, 4.804181, 0.43054),
        (30, 3.874252, 0.353484),
        (45, 3.687507, 0.338201),
        (60, 2.905136, 0.275261),
        (90, 2.471236, 0.241465),
        (120, 2.243992, 0.224241),
        (180, 0.922679, 0.137702),
    ],
    (4, "b10"): [
        (15, 0.186897, 0.043179),
        (30, 0.238582, 0.046576),
        (45, 0.268357, 0.048771),
        (60, 0.377915, 0.057968),
        (90, 0.332696, 0.053988),
        (120, 0.410503, 0.060963),
        (180, 0.487949, 0.068419),
    ],
    (4, "ohb10"): [
        (15, 0.750567, 0.146042),
        (30, 0.957066, 0.185626),
        (45, 1.058638, 0.205133),
        (60, 1.40061, 0.270906),
        (90, 1.342636, 0.259748),
        (120, 1.652208, 0.319353),
        (180, 2.005941, 0.387509),
    ],
    (5, "ohb10"): [
        (5, 2.187219, 0.365852),
        (15, 1.490176, 0.249545),
        (30, 1.243819, 0.208483),
        (60, 1.100679, 0.184647),
        (90, 1.142316, 0.191578),
        (120, 0.794621, 0.13378),
        (180, 0.696621, 0.117543),
    ],
    (6, "ohb10"): [
        (15, 0.098, 0.023108),
        (30, 0.1573, 0.030931),
        (45, 0.165, 0.032031),
        (60, 0.23, 0.041749),
        (90, 0.374, 0.064588),
        (120, 0.445, 0.076127),
        (180, 0.46, 0.090733),
    ],
    (6, "zea"): [
        (15, 2.761, 0.172674),
        (30, 2.93, 0.183243),
        (45, 2.842, 0.17774),
        (60, 2.763, 0.172799),
        (90, 2.581, 0.161417),
        (120, 2.449, 0.153161),
        (180, 2.128, 0.133086),
    ],
}


def test_bruno():
    """Six experiments on schedules that begin before their first measurement."""
    parts, scales = [], 0.0
    for number, (substrate, factors) in EXPERIMENTS.items():
        measured = {name: rows for (k, name), rows in BRUNO.items() if k == number}
        time = sorted({0, *(minute for rows in measured.values() for minute, *_ in rows)})
        signals = {name: np.ones(len(time)) for name in Bruno.inputs}
        for name, rows in measured.items():
            signals[f"y_{name}"] = np.full(len(time), math.nan)
            for minute, value, deviation in rows:
                signals[f"y_{name}"][time.index(minute)] = value / deviation
                signals[f"sd_{name}"][time.index(minute)] = deviation
                scales += math.log(deviation)
        names = ("kb1", "kb2", "kc1", "kc2", "kc4", "k5")
        body = {"__doc__": Bruno.__doc__, "reactions": dict(zip(names, factors, strict=True))}
        model = type(f"Bruno{number}", (Bruno,), body)()
        initial = dict.fromkeys(Bruno.states, 0.0) | {substrate: lambda p: p.begin}
        criterion = gb.OutputError(noise=dict.fromkeys(Bruno.outputs, 1.0), initial=initial)
        hold = dict.fromkeys(Bruno.inputs, math.inf)
        record = gb.Record(time, signals, hold=hold, name=f"experiment {number}")
        rename = {"begin": f"begin_{number}"}
        parts.append(gb.Problem(model, record, criterion, rename=rename))
    fit = gb.fit(sum(parts), 1, progress=False)
    assert fit.cost + scales == pytest.approx(-46.688, abs=0.001)
    published = {"kb1": 0.0166284, "kb2": 0.00584383, "kc1": 0.00167883, "kc2": 0.00697599}
    published |= {"kc4": 0.0060827, "k5": 0.00308667, "szea": 0.516832, "begin_1": 4.22229}
    for name, value in published.items():
        assert fit.estimate[name] == pytest.approx(value, rel=1e-4), name


# --- stochastic differential equations


class Ornstein(gb.StateSpace):
    """Two coupled Ornstein-Uhlenbeck processes, as in the tests of ctsmTMB (other numbers)."""

    states, inputs, outputs = ("x1", "x2"), ("u1", "u2"), ("y1", "y2")
    theta = gb.Parameter(1.5, bounds=(0.1, 20))
    alpha = gb.Parameter(0.5, bounds=(0.05, 20))

    def derivative(self, x, u, p):
        return (p.theta * (u.u1 - x.x1), p.alpha * (x.x1 - x.x2) + u.u2)

    def output(self, x, u, p):
        return (x.x1, x.x2)


STEP = 0.1  # s
ORNSTEIN = {"theta": 2.0, "alpha": 1.0, "w_x1": 0.5, "w_x2": 0.3, "v_y1": 0.1, "v_y2": 0.05}


def sampled_ornstein(p):
    """Return transition, input matrix, covariance of a step and in rest, and that of the noise."""
    A = np.array([[-p["theta"], 0], [p["alpha"], -p["alpha"]]])
    B = np.array([[p["theta"], 0], [0, 1.0]])
    both = expm(np.block([[A, B], [np.zeros((2, 4))]]) * STEP)
    F, G = both[:2, :2], both[:2, 2:]
    rest = solve_continuous_lyapunov(A, -np.diag([p["w_x1"] ** 2, p["w_x2"] ** 2]))
    return F, G, rest - F @ rest @ F.T, rest, np.diag([p["v_y1"] ** 2, p["v_y2"] ** 2])


def negative_log_likelihood(unknowns, u, y):
    """Return that of all samples by a Kalman filter that begins with the stationary covariance."""
    F, G, Q, P, R = sampled_ornstein(dict(zip(ORNSTEIN, np.exp(unknowns[:6]), strict=True)))
    x, total = unknowns[6:], 0.0
    for k in range(y.shape[1]):
        S, error = P + R, y[:, k] - x
        total += 0.5 * (np.log(np.linalg.det(2 * math.pi * S)) + error @ np.linalg.solve(S, error))
        K = P @ np.linalg.inv(S)
        x, P = F @ (x + K @ error) + G @ u[:, k], F @ (P - K @ P) @ F.T + Q
    return total


def test_coupled_ornstein_uhlenbeck_processes():
    rng, count = np.random.default_rng(5), 150
    u = np.array([np.repeat(rng.choice([-a, a], 150 // n), n) for a, n in ((1.0, 15), (0.5, 10))])
    F, G, Q, rest, R = sampled_ornstein(ORNSTEIN)
    x, y = np.linalg.cholesky(rest) @ rng.standard_normal(2), np.empty((2, count))
    for k in range(count):
        y[:, k] = x + np.sqrt(np.diag(R)) * rng.standard_normal(2)
        x = F @ x + G @ u[:, k] + np.linalg.cholesky(Q) @ rng.standard_normal(2)

    begin = np.r_[np.log(list(ORNSTEIN.values())), y[:, 0]]
    exact = minimize(negative_log_likelihood, begin, (u, y), "BFGS", options={"gtol": 1e-3})
    signals = {"u1": u[0], "u2": u[1], "y1": y[0], "y2": y[1]}
    record = gb.Record(STEP * np.arange(count), signals, hold={"u1": math.inf, "u2": math.inf})
    criterion = gb.PredictionError(process_noise=("x1", "x2"))
    fit = gb.fit(gb.Problem(Ornstein(), record, criterion), 1, progress=False)
    # The filter of greybox is steady from the first sample on.
    for name, logarithm in zip(ORNSTEIN, exact.x, strict=False):
        error = fit.standard_error[name]
        assert abs(fit.estimate[name] - math.exp(logarithm)) < 0.3 * error, name
