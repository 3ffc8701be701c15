"""Estimates from manoeuvres against truths, and against output error in the time domain."""

import numpy as np
import pytest
from benchmark_module import benchmark

import greybox as gb
from greybox.regression import fit_transients
from greybox.spectral import transient_spectrum

transient_coverage = benchmark("transient_coverage")
BAND = transient_coverage.BAND
LATERAL = transient_coverage.LATERAL
SHORT_PERIOD = transient_coverage.SHORT_PERIOD
Lateral = transient_coverage.Lateral
ShortPeriod = transient_coverage.ShortPeriod
coverage = transient_coverage.coverage
lateral_record = transient_coverage.lateral_record
measured = transient_coverage.measured
short_period_record = transient_coverage.short_period_record

MOVING = (8.0, (1.0, 2.0, 2.5, 3.0), [0.005, 0.01])


@pytest.fixture(scope="module")
def clean():
    return short_period_record(*MOVING)


@pytest.mark.parametrize("criterion", ["output error", "equation error"])
def test_the_truth_of_a_manoeuvre_that_ends_moving(clean, criterion):
    """Without noise: states and input move at both ends, and trim values are unknown."""
    spectrum = transient_spectrum(measured(clean, {}, np.random.default_rng(0)), "u", "q", BAND)
    fit = fit_transients(ShortPeriod(), spectrum, criterion, starts=4)
    assert fit.converged
    assert fit.agreeing[0] >= 3
    for name, value in SHORT_PERIOD.items():
        assert fit.estimate[name] == pytest.approx(value, rel=5e-3), name
    # Their ratio is no response: the end term is what makes it one.
    response = gb.frequency_response(ShortPeriod(), SHORT_PERIOD, spectrum.omega).response
    ratio = spectrum.outputs["q"] / spectrum.inputs["u"]
    assert np.median(np.abs(ratio / response - 1)) > 0.05


def test_coupled_inputs_and_outputs():
    """Two inputs and two outputs in one spectrum; an output that is not there is left out."""
    record = lateral_record()
    both = transient_spectrum(record, ["da", "dr"], ["roll", "yaw"], BAND)
    fit = fit_transients(Lateral(), both, starts=1)
    for name, value in LATERAL.items():
        assert fit.estimate[name] == pytest.approx(value, rel=5e-3, abs=2e-3), name
    roll = transient_spectrum(record, ["da", "dr"], "roll", BAND)
    alone = fit_transients(Lateral(), roll, fixed={"Nr": LATERAL["Nr"], "Nd": LATERAL["Nd"]}, starts=1)
    assert set(alone.noise) == {"roll"}
    assert alone.estimate["Lr"] == pytest.approx(LATERAL["Lr"], rel=0.02)


def test_intervals_hold_the_truth():
    """One manoeuvre of 8 s, from 0.5 to 10 rad/s; the whole table is in benchmarks/results."""
    case = (ShortPeriod(), SHORT_PERIOD, [short_period_record(*MOVING)], {"q": 0.02}, ["u"], ["q"])
    shares, rms = coverage(case, 60, seed=3)
    assert 0.90 <= np.mean(list(shares.values())) <= 0.99
    assert 0.8 < np.sqrt(np.mean(rms**2)) < 1.3


def test_agreement_with_output_error_in_the_time_domain(clean):
    """The same record: they differ by no more than the errors, and are as accurate but for what the band leaves out."""
    # Without trim values, which output error in time would have to estimate.
    noisy = clean["q"] + 0.02 * np.random.default_rng(5).standard_normal(len(clean))
    record = clean.with_signals(q=noisy)
    # The delay is known: the cost in time has a kink where the delay of a held input is a multiple of the step.
    known = {"T": SHORT_PERIOD["T"]}
    ours = fit_transients(ShortPeriod(), transient_spectrum(record, "u", "q", (0.5, 60)), fixed=known, starts=1)
    theirs = gb.fit(gb.Problem(ShortPeriod(), record, fixed=known), starts=1)
    for name in ours.standard_error:
        assert abs(ours.estimate[name] - theirs.estimate[name]) < 1.5 * ours.standard_error[name], name
        assert 0.7 < ours.standard_error[name] / theirs.standard_error[name] < 2, name
    assert ours.noise["q"] == pytest.approx(0.02, rel=0.25)


def test_trim_values_do_not_matter(clean):
    """Constants of any size are nothing at the frequencies of a spectrum."""
    noisy = measured(clean, {"q": 0.02}, np.random.default_rng(1))
    shifted = noisy.with_signals(u=noisy["u"] + 10, q=noisy["q"] - 100)
    a, b = (fit_transients(ShortPeriod(), transient_spectrum(r, "u", "q", BAND), starts=1) for r in (noisy, shifted))
    assert a.estimate == pytest.approx(b.estimate, rel=1e-4)


def test_several_manoeuvres_say_more(clean):
    """Two of one aircraft share the parameters, each has its own end term."""
    random = np.random.default_rng(2)
    spectra = [
        transient_spectrum(measured(r, {"q": 0.02}, random), "u", "q", BAND)
        for r in (clean, short_period_record(6.0, (0.5, 1.2, 1.9), [0.0, 0.0]))
    ]
    one, two = (fit_transients(ShortPeriod(), s, starts=1) for s in (spectra[0], spectra))
    assert two.dof == one.dof + 2 * len(spectra[1]) - 2
    assert len(two.ends) == 2
    assert all(two.standard_error[name] < 1.1 * one.standard_error[name] for name in SHORT_PERIOD)


class Twice(gb.TransferFunction):
    """A gain that is a product of two."""

    input, output = "u", "q"
    a = gb.Parameter(2.0)
    b = gb.Parameter(3.0)
    c = gb.Parameter(2.0, bounds=(0.1, 10))

    def response(self, s, p):
        """Return the response."""
        return p.a * p.b / (s + p.c)


def test_what_is_not_determined_is_said(clean):
    """No standard error, and a sentence that names the values."""
    spectrum = transient_spectrum(measured(clean, {"q": 0.02}, np.random.default_rng(1)), "u", "q", BAND)
    fit = fit_transients(Twice(), spectrum, starts=1)
    assert np.isnan([fit.standard_error["a"], fit.standard_error["b"]]).all()
    assert np.isfinite(fit.standard_error["c"]) or "c" in " ".join(fit.warnings)
    assert "do not determine a, b" in " ".join(fit.warnings)
    assert "not determined" in str(fit)


def test_refusals(clean):
    """In one sentence with the value and the cure."""
    spectrum = transient_spectrum(clean, "u", "q", BAND)
    with pytest.raises(ValueError, match="needs the input 'da'"):
        fit_transients(Lateral(), spectrum)
    with pytest.raises(ValueError, match="criterion 'L1' is not known"):
        fit_transients(ShortPeriod(), spectrum, "L1")
    with pytest.raises(ValueError, match="6 real numbers for 7 unknowns"):
        fit_transients(ShortPeriod(), transient_spectrum(clean, "u", "q", (0.5, 2.5)))
    with pytest.raises(TypeError, match="is no TransientSpectrum"):
        fit_transients(ShortPeriod(), [clean])
