"""Fits of manoeuvres against truths, output error in time, and direct evaluation."""

from dataclasses import replace

import numpy as np
import pytest
from benchmark_module import benchmark
from declared_models import Lag
from scipy.signal import lfilter

import greybox as gb
from greybox.data.spectral import transient_spectrum

pytestmark = pytest.mark.usefixtures("unjudged_file")

study = benchmark("transient_coverage")
BAND, LATERAL, SHORT_PERIOD = study.BAND, study.LATERAL, study.SHORT_PERIOD
Lateral, ShortPeriod = study.Lateral, study.ShortPeriod
MOVING = (8.0, (1.0, 2.0, 2.5, 3.0), [0.005, 0.01])


def fitted(problem, starts=1, *, profiles=False):
    return gb.fit(problem, starts=starts, profiles=profiles, progress=False)


@pytest.fixture(scope="module")
def clean():
    return study.short_period_record(*MOVING)


@pytest.fixture(scope="module")
def cases():
    return study.cases()


@pytest.fixture(scope="module")
def spectrum(clean):
    return transient_spectrum(
        study.measured(clean, {"q": 0.02}, np.random.default_rng(1)), "u", "q", BAND
    )


@pytest.fixture(scope="module")
def fit(spectrum):
    return fitted(gb.Problem(ShortPeriod(), spectrum))


@pytest.mark.parametrize("criterion", [gb.OutputError(), gb.EquationError()])
def test_the_truth_of_a_manoeuvre_that_ends_moving(clean, criterion):
    """Without noise: states and input move at both ends, and trim values are unknown."""
    spectrum = transient_spectrum(
        study.measured(clean, {}, np.random.default_rng(0)), "u", "q", BAND
    )
    fit = fitted(gb.Problem(ShortPeriod(), spectrum, criterion), starts=2)
    assert fit.converged
    assert fit.agreeing == 2
    for name, value in SHORT_PERIOD.items():
        assert fit.estimate[name] == pytest.approx(value, rel=5e-3), name
    # Their ratio is no response: the end term is what makes it one.
    response = gb.frequency_response(ShortPeriod(), SHORT_PERIOD, spectrum.omega).response
    ratio = spectrum.outputs["q"] / spectrum.inputs["u"]
    assert np.median(np.abs(ratio / response - 1)) > 0.05


def test_coupled_inputs_and_outputs():
    """Two inputs and two outputs in one spectrum; an output that is not there is left out."""
    record = study.lateral_record()
    both = fitted(
        gb.Problem(Lateral(), transient_spectrum(record, ["da", "dr"], ["roll", "yaw"], BAND))
    )
    for name, value in LATERAL.items():
        assert both.estimate[name] == pytest.approx(value, rel=5e-3, abs=2e-3), name
    known = {"Nr": LATERAL["Nr"], "Nd": LATERAL["Nd"]}
    alone = fitted(
        gb.Problem(Lateral(), transient_spectrum(record, ["da", "dr"], "roll", BAND), fixed=known)
    )
    assert alone.spectra[0].outputs == ("roll",)
    assert alone.estimate["Lr"] == pytest.approx(LATERAL["Lr"], rel=0.02)


@pytest.mark.parametrize(
    "name",
    ["one 2-1-1 of 8 s", "turbulence, equation error", "noise louder at the beginning"],
)
def test_intervals_hold_the_truth(name, cases):
    """One manoeuvre of 8 s, from 0.5 to 10 rad/s; the whole table is in benchmarks/results."""
    # Of 20 intervals of 95 %, seven miss with a probability of 3e-5.
    shares, rms, _ = study.coverage(cases[name], 4, seed=3)
    assert np.mean(list(shares.values())) >= 0.7
    assert 0.5 < np.sqrt(np.mean(rms**2)) < 1.6


def test_agreement_with_output_error_in_the_time_domain(clean):
    """The same record: they differ by no more than the errors, and are as accurate but for what the band leaves out."""
    # Without trim values, which output error in time would have to estimate.
    noisy = clean["q"] + 0.02 * np.random.default_rng(5).standard_normal(len(clean))
    record = clean.with_signals(q=noisy)
    # The delay is known: the cost in time has a kink where the delay of a held input is a multiple
    # of the step.
    known = {"T": SHORT_PERIOD["T"]}
    ours = fitted(
        gb.Problem(ShortPeriod(), transient_spectrum(record, "u", "q", (0.5, 60)), fixed=known)
    )
    theirs = fitted(gb.Problem(ShortPeriod(), record, fixed=known))
    for name in ours.free:
        assert abs(ours.estimate[name] - theirs.estimate[name]) < 1.5 * ours.standard_error[name], (
            name
        )
        # The size of the errors is estimated line by line, from few lines where K acts.
        assert 0.7 < ours.standard_error[name] / theirs.standard_error[name] < 2.5, name
    assert np.sqrt(ours.spectra[0].noise[0, 0]) == pytest.approx(0.02, rel=0.25)


def test_the_cost_is_the_likelihood_of_the_outputs(spectrum):
    """By brute force: a linear regression of the outputs on the model at the estimate and on its end terms."""
    spectrum = replace(spectrum, held=())  # what samples add is tested with held inputs
    fit = fitted(gb.Problem(ShortPeriod(), spectrum, gb.EquationError()))
    p = fit.estimate
    s = 1j * spectrum.omega
    pole = s**2 + 2 * p["z"] * p["w"] * s + p["w"] ** 2
    modelled = p["K"] * (p["T_z"] * s + 1) / pole * spectrum.delayed_input("u", p["T"])[0]
    errors, basis = pole * (spectrum.outputs["q"] - modelled), np.array([np.ones_like(s), s]).T
    parts = [np.concatenate([x.real, x.imag]) for x in (errors, *basis.T)]
    left = (
        parts[0]
        - np.array(parts[1:]).T @ np.linalg.lstsq(np.array(parts[1:]).T, parts[0], rcond=None)[0]
    )
    variance = np.mean(left**2) / (spectrum.step * spectrum.duration / 2)
    n = len(left)
    assert fit.cost == pytest.approx(
        n / 2 * (np.log(2 * np.pi * variance) + 1) - 2 * np.log(np.abs(pole)).sum()
    )


def test_every_field_of_a_fitted_spectrum(spectrum, fit):
    (part,) = fit.spectra
    left = part.residual("q")
    np.testing.assert_allclose(left, spectrum.outputs["q"] - part.fitted["q"])
    percent = 100 * (1 - np.linalg.norm(left) / np.linalg.norm(spectrum.outputs["q"]))
    assert part.fit_percent("q") == pytest.approx(percent)
    variance = np.mean(np.abs(left) ** 2) / (spectrum.step * spectrum.duration)
    assert part.noise[0, 0] == pytest.approx(variance)
    assert (part.outputs, part.at, part.nuisances) == (("q",), {}, 2 + 1)
    known = fitted(gb.Problem(ShortPeriod(), spectrum, gb.OutputError(noise={"q": 0.02}))).spectra[
        0
    ]
    assert known.nuisances == 2
    assert known.noise[0, 0] == pytest.approx(4e-4)


def test_trim_values_do_not_matter(clean, fit):
    """Constants of any size are nothing at the frequencies of a spectrum."""
    noisy = study.measured(clean, {"q": 0.02}, np.random.default_rng(1))
    shifted = noisy.with_signals(u=noisy["u"] + 10, q=noisy["q"] - 100)
    other = fitted(gb.Problem(ShortPeriod(), transient_spectrum(shifted, "u", "q", BAND)))
    assert other.estimate == pytest.approx(fit.estimate, rel=1e-4)


def test_several_manoeuvres_say_more(clean, spectrum, fit):
    """Two of one aircraft share the parameters, each has its own end term and noise."""
    second = study.measured(clean, {"q": 0.02}, np.random.default_rng(2))
    two = fitted(gb.several(ShortPeriod(), [spectrum, transient_spectrum(second, "u", "q", BAND)]))
    # The size of the errors is that of few lines, in both.
    assert fit.dof < two.dof < 2 * sum(len(part.data) for part in two.spectra) - 9
    assert [set(part.ends) for part in two.spectra] == [{"q_0", "q_1"}] * 2
    # On average: each error varies with the few lines nearby, and that of a delay with its fraction
    # of a sample.
    ratios = [two.standard_error[name] / fit.standard_error[name] for name in SHORT_PERIOD]
    assert np.mean(ratios) < 1
    assert max(ratios) < 1.2


def test_sums_with_records_and_responses(clean, spectrum, fit):
    """A likelihood each: what is known twice is known to less than 1/sqrt(2) of its error."""
    omega = np.geomspace(1, 10, 12)
    true = gb.frequency_response(ShortPeriod(), SHORT_PERIOD, omega)
    response = gb.FrequencyResponse(
        omega, true.response * 1.001, variance=1e-4 * np.abs(true.response) ** 2
    )
    noisy = clean.with_signals(
        q=clean["q"] + 0.02 * np.random.default_rng(8).standard_normal(len(clean))
    )
    parts = [
        gb.Problem(ShortPeriod(), spectrum),
        gb.Problem(ShortPeriod(), response, gb.MaximumLikelihood()),
        gb.Problem(ShortPeriod(), noisy),
    ]
    both = fitted(sum(parts))
    assert both.converged
    for name, value in SHORT_PERIOD.items():
        assert abs(both.estimate[name] - value) < 4 * both.standard_error[name] + 1e-3 * value, name
        assert both.standard_error[name] < fit.standard_error[name] / np.sqrt(2), name
    with pytest.raises(ValueError, match="would count the same data twice"):
        gb.Problem(ShortPeriod(), clean) + gb.Problem(
            ShortPeriod(), transient_spectrum(clean, "u", "q", BAND)
        )


def test_an_answer_survives_its_file(fit, tmp_path):
    """Everything that it says, and the measured and fitted transforms."""
    gb.save(fit, tmp_path / "fit.h5")
    loaded = gb.load(tmp_path / "fit.h5", models=[ShortPeriod])
    assert str(loaded) == str(fit)
    part, same = fit.spectra[0], loaded.spectra[0]
    assert same.data.checksum == part.data.checksum
    np.testing.assert_array_equal(same.fitted["q"], part.fitted["q"])
    assert same.ends == part.ends
    assert same.data.stretch == part.data.stretch


class Gusty(gb.StateSpace):
    """The short period with a gust in its equation as a state of the model."""

    states, inputs, outputs, delays = ("q", "rest", "gust"), ("u",), ("q",), {"u": "T"}
    K, T_z, w, z, T = (ShortPeriod().parameters[name] for name in SHORT_PERIOD)
    T_gust = gb.Parameter(0.4, bounds=(0.02, 8.0), scale="log")

    def derivative(self, x, u, p):
        return (
            x.rest - 2 * p.z * p.w * x.q + p.K * p.T_z * u.u,
            p.K * u.u + x.gust - p.w**2 * x.q,
            -x.gust / p.T_gust,
        )

    def output(self, x, u, p):
        return (x.q,)


def test_turbulence_is_named_and_its_color_estimated(clean, fit):
    """Output error names gusts, not white noise; with them it is the fit of a model with a gust."""
    noisy = study.short_period_in_gusts(clean, np.random.default_rng(0), 1.0, 0.1)
    spectrum = transient_spectrum(noisy, "u", "q", BAND)
    blind = gb.fit(gb.Problem(ShortPeriod(), spectrum), starts=[SHORT_PERIOD], progress=False)
    assert "turbulence" in " ".join(blind.warnings)
    for name, (low, high) in blind.interval(0.99).items():
        assert low < SHORT_PERIOD[name] < high, name
    assert "turbulence" not in " ".join(fit.warnings)

    start = {**SHORT_PERIOD, "T_gust": 1.0}
    aware, modeled = (
        gb.fit(gb.Problem(model, spectrum, rule), starts=[start], profiles=False, progress=False)
        for model, rule in (
            (ShortPeriod(), gb.EquationError(gusts=True)),
            (Gusty(), gb.EquationError()),
        )
    )
    assert "larger in a part" not in " ".join(aware.warnings)
    assert aware.cost == pytest.approx(modeled.cost, abs=1e-6)
    for name in start:
        assert aware.estimate[name] == pytest.approx(modeled.estimate[name], rel=1e-4), name
        # Other states, and so other disturbances, may still be in the errors.
        assert aware.standard_error[name] == pytest.approx(modeled.standard_error[name], rel=0.03)


def test_gusts_that_act_where_the_elevator_does_are_named(clean):
    """They reach the equation through the zero of the plant, so that its errors rise with frequency."""
    noise, still = 0.03 * np.random.default_rng(3).normal(size=len(clean)), np.zeros(len(clean))
    pushed = gb.simulate(ShortPeriod(), SHORT_PERIOD, clean.with_signals(u=noise, q=still))
    noisy = clean.with_signals(q=clean["q"] + pushed["q"])
    spectrum = transient_spectrum(noisy, "u", "q", (0.5, 30.0))
    problem = gb.Problem(ShortPeriod(), spectrum, gb.EquationError())
    blind = gb.fit(problem, starts=[SHORT_PERIOD], progress=False)
    assert "larger in a part of the band" in " ".join(blind.warnings)


def test_short_manoeuvres_in_gusts_are_named_by_output_error():
    """Twelve lines show little: by the size of the remaining errors, 15 of these 20 are recognized."""
    inputs = np.repeat(np.random.default_rng(2).normal(size=20), 10)
    step, lag, named = 0.05, np.exp(-0.05 / 0.4), 0
    for seed in range(20):
        random = np.random.default_rng(seed)
        white = np.sqrt(1 - np.exp(-2 * step)) * random.normal(size=201)
        gust = lfilter([1], [1, -np.exp(-step)], white)[1:]
        y = lfilter([0, 1 - lag], [1, -lag], 2 * inputs + 0.4 * gust)
        y = y + 0.01 * random.normal(size=200)
        record = gb.Record(step * np.arange(200), {"u": inputs, "y": y}, hold={"u": np.inf})
        data = transient_spectrum(record, "u", "y", (0.5, 8.0))
        fit = fitted(gb.Problem(Lag(), data), [{"K": 2, "T": 0.4}])
        named += "larger in a part of the band" in " ".join(fit.warnings)
    assert named >= 19


class Twice(gb.TransferFunction):
    """A gain that is a product of two."""

    input, output = "u", "q"
    a = gb.Parameter(2.0, bounds=(0.1, 10))
    b = gb.Parameter(3.0, bounds=(0.1, 10))
    c = gb.Parameter(2.0, bounds=(0.1, 10))

    def response(self, s, p):
        """Return the response."""
        known = SHORT_PERIOD
        motion = s**2 + 2 * known["z"] * known["w"] * s + known["w"] ** 2
        return p.a * p.b * (p.c * s + 1) / motion * gb.exp(-s * known["T"])


class TwiceALag(Twice):
    """The same without the oscillation."""

    def response(self, s, p):
        """Return the response."""
        return p.a * p.b / (s + p.c)


def test_what_is_not_determined_is_said(spectrum):
    """No standard error, and a sentence that names the values; and that the model leaves something out."""
    fit = fitted(gb.Problem(Twice(), spectrum))
    assert np.isnan([fit.standard_error["a"], fit.standard_error["b"]]).all()
    assert np.isfinite(fit.standard_error["c"])
    assert "a and b" in " ".join(fit.warnings)
    incomplete = fitted(gb.Problem(TwiceALag(), spectrum))
    assert "or of a model that misses something" in " ".join(incomplete.warnings)


def test_nested_and_other_models_are_compared(spectrum, fit):
    """AIC prefers the true structure, and the test finds the term that the smaller one lacks."""
    known = fitted(gb.Problem(ShortPeriod(), spectrum, fixed={"T": 0.0}))
    test = gb.validation.nested_test(known, fit)
    assert test.p_value < 1e-3
    assert "T is needed" in str(gb.compare(known, fit))


def test_a_misleading_standard_error_comes_with_a_profile(clean):
    """Refits with the lead fixed at the ends cost equally much, as far as the standard error says."""

    def measured(seed):
        noisy = study.short_period_in_gusts(clean, np.random.default_rng(seed), 3.0, 0.3)
        return transient_spectrum(noisy, "u", "q", BAND)

    spectra = {seed: measured(seed) for seed in (7, 8)}

    def problem(seed, **held):
        return gb.Problem(ShortPeriod(), spectra[seed], gb.EquationError(gusts=True), fixed=held)

    known = {name: SHORT_PERIOD[name] for name in ("z", "T")}
    fit = fitted(problem(7, **known), profiles=True)
    best, (low, high) = fit.estimate["T_z"], fit.profiles["T_z"].interval
    assert high - best > 1.5 * (best - low)

    def rise(value):
        return fitted(problem(7, T_z=value, **known)).cost - fit.cost

    at_low, at_high = rise(low), rise(high)
    assert at_low == pytest.approx(at_high, rel=2e-3)
    # The standard error follows from the expected curvature.
    step = 0.05 * fit.standard_error["T_z"]
    curvature = (rise(best - step) + rise(best + step)) / (2 * step**2)
    half_width = fit.interval()["T_z"][1] - best
    assert at_low == pytest.approx(curvature * half_width**2, rel=0.1)

    many = fitted(problem(7) + problem(8), profiles=True)
    assert many.profiles is None
    assert "standard errors that mislead: K, T_z" in many.notes[-1]


def test_refusals(clean, spectrum):
    """In one sentence with the value and the cure."""
    with pytest.raises(ValueError, match="needs the input 'da'"):
        gb.Problem(Lateral(), spectrum)
    with pytest.raises(
        TypeError,
        match=r"give a criterion such as OutputError\(\), for a TransientSpectrum",
    ):
        gb.Problem(ShortPeriod(), spectrum, gb.RelativeError())
    with pytest.raises(ValueError, match="PredictionError is for records"):
        gb.Problem(Lateral(), spectrum, gb.PredictionError())
    with pytest.raises(ValueError, match="biases of OutputError is for records"):
        gb.Problem(ShortPeriod(), spectrum, gb.OutputError(biases=["q"]))
    with pytest.raises(ValueError, match="EquationError is for the Fourier integrals"):
        gb.Problem(ShortPeriod(), clean, gb.EquationError())
    problem = gb.Problem(ShortPeriod(), spectrum)
    with pytest.raises(ValueError, match="use method=MultipleShooting"):
        gb.fit(problem, starts=1, method=gb.Collocation(), progress=False)
    few = fitted(gb.Problem(ShortPeriod(), transient_spectrum(clean, "u", "q", (0.5, 2.5))))
    assert "no degrees of freedom" in " ".join(few.warnings) or not few.converged


def test_a_report_of_a_manoeuvre(fit, tmp_path):
    """It is written, and says what was fitted."""
    gb.report(fit, tmp_path / "report.html")
    assert "12 lines in 1 manoeuvre" in (tmp_path / "report.html").read_text(encoding="utf-8")


class Gain(gb.StateSpace):
    """An output in proportion to the input."""

    states, inputs, outputs = (), ("u",), ("y",)
    K = gb.Parameter(2.0, bounds=(0.1, 20))

    def derivative(self, x, u, p):
        return ()

    def output(self, x, u, p):
        return (p.K * u.u,)


@pytest.mark.usefixtures("judged")
@pytest.mark.parametrize("criterion", [gb.OutputError(), gb.EquationError()])
def test_a_model_without_states_is_fitted_to_a_manoeuvre(criterion):
    random = np.random.default_rng(0)
    u = np.repeat(random.uniform(-1, 1, 40), 20)
    flight = gb.Record(
        0.02 * np.arange(800), {"u": u, "y": 2.5 * u + 0.01 * random.normal(size=800)}
    )
    spectrum = gb.spectral.transient_spectrum(flight, "u", "y", (0.5, 20))
    fit = gb.fit(gb.Problem(Gain(), spectrum, criterion), starts=1, progress=False)
    assert fit.estimate["K"] == pytest.approx(2.5, abs=4 * fit.standard_error["K"])
    assert fit.misfit.explains


class Settling(gb.StateSpace):
    """A lag whose rate is a root, which has no value below one."""

    states, inputs, outputs = ("y",), ("u",), ("q",)
    a = gb.Parameter(0.5, bounds=(0, 30))
    b = gb.Parameter(5.0, bounds=(0, 30))

    def derivative(self, x, u, p):
        return (p.b * u.u - gb.sqrt(p.a - 1) * x.y,)

    def output(self, x, u, p):
        return (x.y,)


def test_a_model_that_is_finite_at_no_start_is_named(spectrum):
    problem = gb.Problem(Settling(), spectrum)
    failed = gb.fit(problem, starts=[{"a": 0.5}, {"a": 0.7}], progress=False)
    assert not failed.converged
    assert "no run reached a finite cost" in " ".join(failed.warnings)
    assert [run.reason for run in failed.runs] == ["no finite response"] * 2


@pytest.mark.parametrize("lines", [(3, 3, 2), (12, 1, 1)])
def test_manoeuvres_of_few_lines_share_the_noise_of_an_output(lines):
    """With a noise of their own, they would be fitted exactly, and decide the estimate."""
    record, random, line = study.lateral_record(), np.random.default_rng(5), np.pi / 4
    spectra = [
        transient_spectrum(
            study.measured(record, {"roll": 0.02, "yaw": 0.01}, random),
            ["da", "dr"],
            ["roll", "yaw"],
            (1.5 * line, (1.5 + count) * line),
        )
        for count in lines
    ]

    def fit_with(noise):
        problems = [gb.Problem(Lateral(), s, gb.OutputError(noise=noise)) for s in spectra]
        return gb.fit(sum(problems[1:], problems[0]), [LATERAL], progress=False, profiles=False)

    fit = fit_with("diagonal")
    sizes = np.sqrt([np.diag(part.noise) for part in fit.parts])
    np.testing.assert_allclose(sizes, sizes[:1].repeat(len(lines), 0))
    stated = fit_with(dict(zip(("roll", "yaw"), sizes[0].tolist(), strict=True)))
    assert fit.estimate == pytest.approx(stated.estimate, rel=1e-5)
    assert fit.standard_error == pytest.approx(stated.standard_error, rel=1e-4)
    low_high = fit.interval(0.999)
    assert all(low_high[name][0] < true < low_high[name][1] for name, true in LATERAL.items())
