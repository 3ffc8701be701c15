"""Two laws of every search and solver, on random problems.

No run ends above the stated cost of its start, and what was found is not thrown away: light modes,
precise and exact data, wrong models, records of which one disagrees, constraints, starts at bounds.
"""

import numpy as np
import pytest
from driven_lag import Lag

import greybox as gb
from greybox.engine.solve.search_method import SEARCHES
from greybox.modeling.formulation.included_criteria import (
    CRITERIA,
    SPECTRUM_CRITERIA,
    TIME_CRITERIA,
)
from greybox.workflows.study.stated_problem import METHODS

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Mode(gb.TransferFunction):
    """g (s + a) / (s² + 2 z w s + w²), behind a delay."""

    input, output = "u", "y"
    g = gb.Parameter(5.0, bounds=(0.01, 50))
    a = gb.Parameter(1.0, bounds=(0, 20), unit="1/s")
    w = gb.Parameter(8.0, bounds=(0.5, 30), unit="rad/s")
    z = gb.Parameter(0.2, bounds=(0.001, 2))
    T = gb.Parameter(0.01, bounds=(0, 0.2), unit="s")

    def response(self, s, p):
        mode = s * s + 2 * p.z * p.w * s + p.w**2
        return p.g * (s + p.a) / mode * gb.exp(-s * p.T)


class TwoLags(gb.StateSpace):
    """Two lags in series, of which the second is measured."""

    states, inputs, outputs = ("x", "y"), ("u",), ("y",)
    k = gb.Parameter(1.0, bounds=(0.05, 20), unit="1/s")
    b = gb.Parameter(1.0, bounds=(0.05, 20), unit="1/s")
    g = gb.Parameter(2.0, bounds=(-10, 10))

    def derivative(self, x, u, p):
        return p.g * u.u - p.k * x.x, p.b * (x.x - x.y)

    def output(self, x, u, p):
        return (x.y,)


def starts(model, truth, random, count):
    """The truth, then points anywhere in the bounds, of which some parameters are at one."""
    points = [truth]
    for _ in range(count):
        ends = {n: random.choice(q.bounds) for n, q in model.parameters.items()}
        inside = {n: random.uniform(*q.bounds) for n, q in model.parameters.items()}
        points.append({n: float(ends[n] if random.random() < 0.1 else inside[n]) for n in inside})
    return points


def random_response(seed):
    random, model = np.random.default_rng(seed), Mode()
    omega = np.geomspace(0.5, 30, int(random.integers(8, 25)))
    truth = {
        "g": random.uniform(0.5, 10),
        "a": random.uniform(0, 10),
        "w": random.uniform(2, 15),
        "z": 10 ** random.uniform(-2.5, 0),
        "T": random.choice([0, 0.02, 0.1]),
    }
    measured = gb.frequency_response(model, truth, omega, input="u", output="y").response
    if random.random() < 0.3:
        measured = measured * (1 + random.uniform(0, 3) / (1 + 1j * omega / 3))
    size = 10 ** random.uniform(-4, -1) * np.abs(measured)
    if random.random() < 0.5:
        size = np.full(omega.size, np.median(size))
    error = size * (random.normal(size=omega.size) + 1j * random.normal(size=omega.size)) / 2**0.5
    exact = random.random() < 0.15
    data = gb.FrequencyResponse(
        omega, measured + (not exact) * error, input="u", output="y", variance=size**2
    )
    constraints = [lambda p: p.w - p.a] if random.random() < 0.2 else []
    problem = gb.Problem(model, data, CRITERIA[seed % len(CRITERIA)], constraints=constraints)
    points = starts(model, truth, random, 3)
    return problem, [p for p in points if not constraints or p["w"] >= p["a"]]


def random_records(seed):
    random = np.random.default_rng(seed)
    model = (Lag(), TwoLags())[seed % 2]
    truth = {n: q.start * np.exp(0.3 * random.normal()) for n, q in model.parameters.items()}
    records = []
    for k in range(3):
        n = int(random.integers(60, 160))
        time, u = np.arange(n) * 0.05, np.repeat(random.choice([-1.0, 1.0], n // 10 + 1), 10)[:n]
        flown = gb.Record(time, {"u": u}, hold={"u": np.inf})
        own = truth | ({"g": truth["g"] * random.choice([0.3, 0.5, 2.0])} if k == 2 else {})
        y = gb.simulate(model, own, flown, initial={s: random.normal() for s in model.states})["y"]
        y = y + 10 ** random.uniform(-2.5, -0.5) * random.normal(size=n)
        y += 0.3 * np.sin(3 * time) if random.random() < 0.2 else 0.0  # no model has it
        records.append(gb.Record(time, {"u": u, "y": y}, hold={"u": np.inf, "y": 0.0}))
    return model, records, starts(model, truth, random, 2)


def hold_both(problem, points, method=None, **options):
    fit = gb.fit(problem, points, method=method, profiles=False, progress=False, **options)
    for run in fit.runs:
        begun = gb.cost(problem, dict(zip(fit.free, run.start, strict=True)), method)
        assert not np.isfinite(begun) or run.cost <= begun + 1e-8 * max(1, abs(begun))
    lowest = np.nanmin(fit.runs.cost)
    assert fit.converged
    assert fit.cost <= lowest + 1e-6 * max(1, abs(lowest))
    return fit


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("seed", range(12))
def test_both_hold_for_a_response(seed, search):
    hold_both(*random_response(seed), search=search)


@pytest.mark.parametrize("criterion", TIME_CRITERIA, ids=lambda criterion: criterion.name)
@pytest.mark.parametrize("seed", range(2))
def test_both_hold_for_records_of_which_one_disagrees(seed, criterion):
    model, records, points = random_records(seed)
    hold_both(gb.several(model, records, criterion=criterion), points)


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
@pytest.mark.parametrize("search", SEARCHES)
def test_both_hold_for_every_transcription(method, search):
    model, records, points = random_records(2)
    hold_both(gb.several(model, records[1:]), points[:2], method(), search=search)


@pytest.mark.parametrize("criterion", SPECTRUM_CRITERIA, ids=lambda criterion: criterion.name)
def test_both_hold_for_spectra_of_which_one_disagrees(criterion):
    model, records, points = random_records(4)
    spectra = [gb.spectral.transient_spectrum(r, "u", "y", (0.5, 20)) for r in records]
    hold_both(gb.several(model, spectra, criterion=criterion), points)


def light_mode(damping, seed):
    """A mode on 14 lines with errors of a given variance."""
    truth = {"g": 3.0, "a": 0.0, "w": 5.0, "z": damping, "T": 0.0}
    omega = 2 * np.pi / 12.8 * np.array([1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 19, 24, 30, 37])
    exact = gb.frequency_response(Mode(), truth, omega, input="u", output="y").response
    errors = 0.02 / 2**0.5 * np.random.default_rng(seed).normal(size=(2, 14))
    data = gb.FrequencyResponse(
        omega, exact + errors[0] + 1j * errors[1], input="u", output="y", variance=np.full(14, 4e-4)
    )
    fixed = {"a": 0.0, "T": 0.0}
    return gb.Problem(Mode(), data, gb.MaximumLikelihood(), fixed=fixed), truth


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("damping", [0.03, 0.01])
def test_a_light_mode_is_found_though_rounding_hides_its_gradient(damping, search):
    for seed in range(100, 102):
        problem, truth = light_mode(damping, seed)
        fit = gb.fit(problem, 20, search=search, profiles=False, progress=False)
        assert fit.cost <= gb.cost(problem, {n: truth[n] for n in fit.free})
        assert fit.agreeing >= 15


def test_multistart_solves_records_by_ipopt():
    """With steps so short that none has to be made finer: the runs stay IPOPT's."""
    model, [record, *_], _ = random_records(0)
    problem = gb.Problem(model, record)
    method = gb.MultipleShooting(integrator=gb.RungeKutta(substeps=8))
    fit, wanted = (
        gb.fit(problem, 3, method=method, search=s, profiles=False, progress=False)
        for s in reversed(SEARCHES)
    )
    assert {*fit.runs.status} == {"Solve_Succeeded"}
    assert {*wanted.runs.status} == {"converged"}
    assert fit.cost == pytest.approx(wanted.cost, rel=1e-9)
    assert fit.estimate == pytest.approx(wanted.estimate, rel=1e-4)


def test_multistart_says_what_ipopt_does_not_take():
    model, [record, *_], _ = random_records(0)
    spectrum = gb.spectral.transient_spectrum(record, "u", "y", (0.5, 20))
    with pytest.raises(ValueError, match="search='batched'"):
        gb.fit(gb.Problem(model, spectrum), 2, search="multistart")
