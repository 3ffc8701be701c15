"""Structures over the data sets of a study: the true one wins, by evidence and by prediction."""

from dataclasses import replace

import numpy as np
import pytest
from small_study import Gain, Lag, LagLead, data

import greybox as gb
from greybox.workflows.study.ranking import Result, held_out_error, ranking


def bic(comparison, name, structure):
    return comparison.value(name, structure, data="study", output="BIC less the least")


def test_the_true_structure_is_supported_by_all_data_sets(small_study):
    comparison = gb.compare(small_study)
    assert comparison.supported == "Lag"
    assert "Over 3 data sets" in comparison.verdict
    fits = [small_study[f"slow, {name}"].fit for name in ("Lag", "Gain", "LagLead")]
    pair = gb.compare(*fits, labels=["Lag", "Gain", "LagLead"])
    for name in ("Lag", "Gain", "LagLead"):
        expected = pair.value("BIC less the least", name)
        assert bic(comparison, "slow", name) == expected
    assert "of 3 data sets: Lag in 3 (100 %)" in str(comparison)


def test_records_to_predict_are_for_fits_and_not_for_a_study(small_study):
    record = gb.Record([0.0, 1.0], {"u": [0.0, 1.0]})
    with pytest.raises(ValueError, match="held="):
        gb.compare(small_study, records=[record])


def test_models_of_ones_own_are_given_to_a_study_that_is_read(small_study):
    read = gb.study.read_study(small_study.folder, models=[Lag])
    fit = read["slow, Lag"].fit
    assert fit.response([1.0]).response == pytest.approx(
        small_study["slow, Lag"].fit.response([1.0]).response
    )
    without = gb.study.read_study(small_study.folder)["slow, Lag"].fit
    with pytest.raises(LookupError, match="is needed and was not found"):
        without.response([1.0])


def test_data_without_a_name_are_the_same_for_all_structures(tmp_path):
    unnamed = replace(data("slow"), name="")
    members = [
        gb.study.Member(gb.Problem(model, unnamed), 2, name=model.label)
        for model in (Lag(), Gain())
    ]
    study = gb.batch(members, tmp_path, progress=False)
    assert gb.compare(study).supported == "Lag"
    assert [*study.groups("data")] == [unnamed.checksum[:8]]


def test_another_factor_is_ranked(small_study):
    seeds = small_study.select(data="fast", model="Lag").ranking("seed")
    assert seeds.labels == ("0", "1")
    with pytest.raises(ValueError, match="factor 'colour'"):
        small_study.ranking("colour")


def test_structures_of_one_model_differ_in_what_is_fixed(tmp_path):
    """The data have a lag of 0.35 s: one that is fixed at 4 s does not fit."""
    problem = gb.Problem(Lag(), data("slow"))
    members = [
        gb.study.Member(problem.with_(fixed=fixed), 3, name=str(fixed))
        for fixed in ({}, {"T_lag": 4.0})
    ]
    members.append(gb.study.Member(gb.Problem(Gain(), data("slow")), 3, name="gain"))
    study = gb.batch(members, tmp_path, progress=False)
    comparison = gb.compare(study.select(model="Lag"))
    assert comparison.labels == ("nothing fixed", "T_lag = 4")
    assert comparison.supported == "nothing fixed"
    both = study.ranking("model", "fixed")
    assert both.labels == ("Lag: nothing fixed", "Lag: T_lag = 4", "Gain: nothing fixed")
    assert both.supported == "Lag: nothing fixed"
    # A value that all of them hold is not a difference.
    held = [
        gb.study.Member(
            gb.Problem(LagLead(), data("slow"), fixed={"K": 1.0, **fixed}), 3, name=str(fixed)
        )
        for fixed in ({}, {"T_lead": 0.0})
    ]
    alike = gb.batch(held, tmp_path / "held", progress=False)
    assert gb.compare(alike).labels == ("nothing else", "T_lead = 0")
    assert bic(both, "slow", "Gain: nothing fixed") == bic(gb.compare(study), "slow", "Gain")


class RateLag(Lag):
    """The lag as a rate: the response times s."""

    output = "r"

    def response(self, s, p):
        return super().response(s, p) * s


def test_responses_of_an_angle_and_of_its_rate_are_one_data_set():
    angle = data("slow")
    rate = replace(angle, response=1j * angle.omega * angle.response, output="r")
    other = replace(angle, response=angle.response[::-1], output="y")
    fits = [
        Result(
            model.__name__,
            "slow",
            gb.fit(gb.Problem(model(), response), starts=2, progress=False),
            None,
        )
        for model, response in ((Lag, angle), (RateLag, rate), (LagLead, other))
    ]
    comparison = ranking(fits)
    values = [bic(comparison, "slow", name) for name in ("Lag", "RateLag")]
    assert values == pytest.approx([0.0, 0.0], abs=1e-6)
    assert bic(comparison, "slow 2", "Lag") is None


class Line(gb.StateSpace):
    """A line without dynamics."""

    states, inputs, outputs = (), ("u",), ("y",)
    slope = gb.Parameter(1.0, bounds=(-10, 10))

    def derivative(self, x, u, p):
        return ()

    def output(self, x, u, p):
        return (p.slope * u.u,)


class Bent(Line):
    """A line with a square."""

    bend = gb.Parameter(0.1, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.slope * u.u + p.bend * u.u**2,)


def test_held_out_records_rank_structures_by_their_predictions():
    def record(name, seed):
        rng = np.random.default_rng(seed)
        u = rng.uniform(-1, 1, 40)
        noise = 0.05 * rng.standard_normal(40)
        return gb.Record(
            np.arange(40.0), {"u": u, "y": 2 * u + u**2 + noise}, name=name, has_time=False
        )

    fits = {
        type(model).__name__: gb.fit(gb.Problem(model, record("one", 0)), starts=1, progress=False)
        for model in (Line(), Bent())
    }
    other = [record("two", 1)]
    comparison = ranking(
        Result(name, "one", fit, held_out_error(fit, other)) for name, fit in fits.items()
    )
    measure = "error of held-out predictions, % of the signal"
    line, bent = (
        comparison.value("one", name, data="study", output=measure) for name in ("Line", "Bent")
    )
    expected = gb.compare(*fits.values(), records=other)
    assert 100 - bent == pytest.approx(expected.value("fit", "Bent", data="held-out", output="y"))
    assert bent < line - 5
    assert "of 1 data set: Bent in 1 (100 %)" in str(comparison)
    assert comparison.supported == "Bent"
    # Records of the fits themselves are not held out.
    fit = fits["Line"]
    refusal = held_out_error(fit, [record("one", 0)])
    assert "not held out" in str(ranking([Result("Line", "one", fit, refusal)]))


def test_the_smallest_structure_that_predicts_as_well_is_supported_by_held_out_data(tmp_path):
    def response(name, seed, pole=1.0):
        omega = np.geomspace(0.2, 8, 12)
        noise = 0.02 * np.random.default_rng(seed).standard_normal((2, 12))
        values = 2 / (pole + 1j * omega) * (1 + noise[0] + 1j * noise[1])
        return gb.FrequencyResponse(omega, values, name=name)

    data = [response(f"rec{k}", k) for k in range(2)]
    models = [Lag(), LagLead(), Gain()]
    members = gb.study.grid(models, data, held=response("held", 9), starts=2, seed=0)
    study = gb.batch(members, tmp_path, progress=False)
    comparison = gb.compare(study)
    measure = "error of held-out predictions, % of the signal"
    errors = {
        name: comparison.value("rec1", name, data="study", output=measure)
        for name in ("Lag", "LagLead", "Gain")
    }
    held = response("held", 9)
    fit = study["rec1: Lag"].fit
    relative = np.abs(fit.response(held.omega).response / held.response - 1)
    assert {row["held_out"] for row in study.select(data="rec1", model="Lag").table} == {
        errors["Lag"]
    }
    assert errors["Lag"] == pytest.approx(100 * np.sqrt(np.mean(relative**2)))
    assert errors["Gain"] > 5 * errors["Lag"]
    assert comparison.supported == "Lag"
    assert "within 5 % of the least" in comparison.verdict
    # Other data that are held out are another question, for which the stored runs serve.
    first, *_ = gb.study.grid(models, data, held=response("held", 9, 1.2), starts=2, seed=0)
    again = gb.batch([first], tmp_path, progress=False)[first.name]
    assert again.answer["held_out"] > 2 * errors["Lag"]


def test_records_rank_structures_with_and_without_a_delay():
    # The fit with a delay leaves out the first samples: BIC is that of the others.
    class Instant(gb.StateSpace):
        states, inputs, outputs = ("x",), ("u",), ("y",)
        a = gb.Parameter(3.0, bounds=(0.1, 20))

        def derivative(self, x, u, p):
            return (p.a * (u.u - x.x),)

        def output(self, x, u, p):
            return (x.x,)

    class Late(Instant):
        delays = {"u": "tau"}
        tau = gb.Parameter(0.02, bounds=(0, 0.2))

    random, n, late = np.random.default_rng(3), 200, 4
    u = np.sin(0.02 * np.arange(n) * (1 + 0.04 * np.arange(n)))
    y, keep = np.zeros(n), np.exp(-5 * 0.02)
    for k in range(n - 1):
        y[k + 1] = keep * y[k] + (1 - keep) * (u[k - late] if k >= late else 0.0)
    signals = {"u": u, "y": y + 0.02 * random.normal(size=n)}
    record = gb.Record(0.02 * np.arange(n), signals)
    late_fit, instant = (gb.fit(gb.Problem(m, record), starts=1) for m in (Late(), Instant()))
    assert late_fit.estimate["tau"] == pytest.approx(0.09, abs=0.02)
    ranked = ranking(
        [Result("Late", "one", late_fit, None), Result("Instant", "one", instant, None)]
    )
    assert ranked.supported == "Late"
    # By hand: the residuals of the samples that both compare.
    residuals = np.array([fit.records[0].residual("y") for fit in (late_fit, instant)])
    shared = residuals[:, np.isfinite(residuals).all(axis=0)]
    assert shared.shape[1] < n
    size = shared.shape[1]
    fits = size * np.log(np.mean(shared**2, axis=1))
    expected = fits[1] - fits[0] - np.log(size)
    assert bic(ranked, "one", "Instant") == pytest.approx(expected)
