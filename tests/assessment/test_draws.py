"""Draws from an estimate: held against profiles, held-out truths, and readers of the files."""

import json
import runpy
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import greybox as gb
from greybox.problems import pitch_hover

pytestmark = pytest.mark.usefixtures("unjudged_file")

OMEGA = np.geomspace(0.5, 20, 14)
TRUTH = {"k": 2.0, "T": 0.06}


class Lag(gb.TransferFunction):
    """A lag; its bandwidth follows from it."""

    k = gb.Parameter(1.0, bounds=(0.01, 100))
    T = gb.Parameter(0.03, bounds=(0.01, 1))
    derived = {"bandwidth": lambda p: 1 / p.T}

    def response(self, s, p):
        return p.k / (p.T * s + 1)


def fitted(seed, noise=0.15):
    clean = gb.frequency_response(Lag(), TRUTH, OMEGA)
    errors = noise * np.random.default_rng(seed).normal(size=(2, OMEGA.size))
    data = gb.FrequencyResponse(OMEGA, clean.response * (1 + errors[0] + 1j * errors[1]))
    data = data.with_independent_errors()
    return gb.fit(gb.Problem(Lag(), data), starts=[TRUTH], progress=False)


@pytest.fixture(scope="module")
def fit():
    return fitted(1)


@pytest.fixture(scope="module")
def drawn(fit):
    return gb.draws(fit, 2000)


def test_ranges_are_those_of_the_profile(fit, drawn):
    profiles = gb.profile(fit, ["T", "k", "bandwidth"])
    for name, (low, high) in profiles.intervals.items():
        ends = np.quantile(drawn.columns[name], (0.025, 0.975))
        assert np.allclose(ends, (low, high), atol=0.08 * (high - low)), name


def test_motions_cover_the_true_step_response():
    time = np.array([0.01, 0.03, 0.06, 0.12, 0.3])
    step = TRUTH["k"] * (1 - np.exp(-time / TRUTH["T"]))
    inside = []
    for seed in range(8):
        columns = gb.draws(fitted(seed), 200, seed).columns
        k, T = columns["k"][:, None], columns["T"][:, None]
        low, high = np.quantile(k * (1 - np.exp(-time / T)), (0.025, 0.975), axis=0)
        inside.append((low <= step) & (step <= high))
    # benchmarks/draws_coverage.py has 300 repeats; of eight motions of 95 %, four miss with a
    # probability of 4e-4, and half of the five instants of each on average.
    assert np.mean(inside) >= 0.75


def test_a_parameter_at_its_bound_stays_there_and_the_others_are_drawn():
    for name, bounds in (
        ("a4", (310, 2000)),
        ("a2", (3, 50)),
        ("a1", (-100, -14)),
        ("a3", (9, 50)),
    ):
        problem = replace(pitch_hover.problem(), bounds={name: bounds})
        columns = gb.draws(gb.fit(problem, starts=2, progress=False), 64).columns
        ends = np.abs(columns.pop(name)[:, None] - bounds).min(axis=1)
        assert ends.max() < 1e-9
        assert all(np.isfinite(column).all() for column in columns.values())
        assert all(np.ptp(columns[other]) > 0 for other in {"a1", "a2", "a3", "a4"} - {name})


def test_sets_stay_within_bounds_and_simulate(fit, drawn):
    assert drawn.columns["T"].min() >= 0.01
    assert np.allclose(drawn.columns["bandwidth"], 1 / drawn.columns["T"])
    assert gb.draws(fit, 3)[2] == gb.draws(fit, 3)[2] != gb.draws(fit, 3, seed=1)[2]
    frame = drawn.to_pandas()
    assert frame.shape == (2000, 3)
    assert frame["k"][7] == drawn[7]["k"]
    response = gb.frequency_response(Lag(), drawn[7], OMEGA).response
    assert np.allclose(response, drawn[7]["k"] / (1j * OMEGA * drawn[7]["T"] + 1))


@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("quad.xml", '<a><b T="$T"/></a>', lambda p: ET.parse(p).getroot()[0].get("T")),
        ("quad.json", '{"cost": "$$5", "T": $T}', lambda p: json.loads(p.read_text())["T"]),
        ("quad.py", "parameters = {'T': ${T}}", lambda p: runpy.run_path(p)["parameters"]["T"]),
        ("quad.parm", "SIM_T,$T\n", lambda p: p.read_text().strip().split(",")[1]),
    ],
)
def test_files_of_simulators(name, text, read, fit, tmp_path):
    (tmp_path / name).write_text(text)
    drawn = gb.draws(fit, 3)
    paths = drawn.write(tmp_path / name, tmp_path / "new" / "sets")
    assert [path.name for path in paths] == [name.replace(".", f"_00{k}.") for k in range(3)]
    assert [float(read(path)) for path in paths] == [drawn[k]["T"] for k in range(3)]


def test_mistakes_are_named(fit, tmp_path):
    template = tmp_path / "quad.xml"
    template.write_text("<a b='$mass'/>")
    with pytest.raises(ValueError, match="names mass: the draws have k, T, bandwidth"):
        gb.draws(fit, 3).write(template, tmp_path)
    template.write_text("<a/>")
    with pytest.raises(ValueError, match="no \\$name"):
        gb.draws(fit, 3).write(template, tmp_path)
    for count in (0, -1, 2.5):
        with pytest.raises(ValueError, match=f"count is {count}: give a whole number"):
            gb.draws(fit, count)
    for seed in (-1, 0.5):
        with pytest.raises(ValueError, match=f"seed is {seed}: give a whole number"):
            gb.draws(fit, 3, seed)


def test_directions_without_information_are_refused():
    class Product(Lag):
        c = gb.Parameter(1.0, bounds=(0.1, 10))

        def response(self, s, p):
            return p.c * super().response(s, p)

    data = gb.frequency_response(Lag(), TRUTH, OMEGA)
    with pytest.raises(ValueError, match="do not determine k and c"):
        gb.draws(gb.fit(gb.Problem(Product(), data), starts=2, progress=False))


def test_a_prior_narrows_the_draws(fit):
    data = fit.responses[0].data
    narrow = gb.Problem(Lag(), data, prior={"T": (0.06, 1e-4)})
    drawn = gb.draws(gb.fit(narrow, starts=2, progress=False), 100)
    assert np.std(drawn.columns["T"]) == pytest.approx(1e-4, rel=0.15)


class Motor(gb.StateSpace):
    """Speed and angle of a motor."""

    states, inputs, outputs = ("w", "a"), ("u",), ("w", "a")
    K = gb.Parameter(1.0, bounds=(0, 100))
    T = gb.Parameter(0.5, bounds=(0.01, 5))

    def derivative(self, x, u, p):
        return (p.K * u.u - x.w) / p.T, x.w

    def output(self, x, u, p):
        return x.w, x.a


def test_a_loaded_fit_with_a_prior_draws_its_derived_quantities(tmp_path):
    problem = pitch_hover.problem().with_(criterion=gb.RelativeLikelihood(), prior={"a4": (290, 5)})
    gb.save(gb.fit(problem, starts=5, progress=False), tmp_path / "pitch.h5")
    values = gb.draws(gb.load(tmp_path / "pitch.h5"), 10).columns
    np.testing.assert_allclose(values["a3_tilde"] / values["a3"], 9.8065)


def test_gains_at_their_stability_limit_do_not_narrow_the_other_parameters():
    """Without process noise a predictor has gains of zero, where stability ends for some of them."""
    random, time = np.random.default_rng(1), np.arange(0, 8, 0.05)
    drive = gb.Record(time, {"u": random.choice([-1.0, 0, 1], 16).repeat(10)}, hold={"u": np.inf})
    motion = gb.simulate(Motor(), {"K": 3.0, "T": 0.2}, drive)
    noise = random.normal(size=(2, time.size))
    record = drive.with_signals(w=motion["w"] + 0.1 * noise[0], a=motion["a"] + 0.05 * noise[1])
    predictor, exact = (
        gb.fit(gb.Problem(Motor(), record, criterion), starts=1, progress=False)
        for criterion in (gb.PredictionError(), gb.OutputError())
    )
    assert any("stability limit" in text for text in predictor.warnings)
    drawn = gb.draws(predictor, 100)
    for name in ("K", "T"):
        low, high = np.quantile(drawn.columns[name], (0.16, 0.84))
        assert (high - low) / 2 == pytest.approx(exact.standard_error[name], rel=0.3)


def test_what_is_no_fit_is_named():
    with pytest.raises(
        TypeError, match=r"^fit is 'lag\.h5': give what gb\.fit or gb\.load returns"
    ):
        gb.draws("lag.h5", 3)
