"""Held and interpolated controls: the record decides; where it does not know, the answer states the assumption."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from declared_models import Lag
from numpy.testing import assert_allclose
from scipy.linalg import expm

import greybox as gb
from greybox.assessment.verdict import verdict
from greybox.models.controller import AttitudeController
from greybox.models.tilt import LinearTilt

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {
    "a1": -14.6,
    "a2": 3.0,
    "a3": 8.5,
    "a4": 295.0,
    "a5": 0.16,
    "T_rotor": 0.048,
    "T_delay": 0.01,
}
FREE = ("a1", "a2", "a3", "a4", "T_delay")
SWEEP = gb.experiment.sweep(
    0.5, 15, duration=15, rate=100, amplitude=0.12, dwell=1, signal="reference"
)


def flown(seed=0, **options):
    """The paper's pitch axis in its closed loop, as `virtual_flight` returns it."""
    noise = {"theta": 0.002, "v": 0.03}
    options = {"controller": AttitudeController(rate=100), "noise": noise, "seed": seed, **options}
    return gb.virtual_flight(LinearTilt(), TRUTH, SWEEP, **options)


def fitted(record, criterion=None, **options):
    problem = gb.Problem(LinearTilt(), record, criterion, free=["T_delay"], **options)
    return gb.fit(problem, starts=[{name: TRUTH[name] for name in FREE}], progress=False)


@cache
def flown_fit():
    return fitted(flown())


@pytest.fixture(scope="module")
def unknown():
    return replace(flown(), hold={})


@pytest.fixture(scope="module")
def assumed(unknown):
    return fitted(unknown)


def test_a_virtual_flight_gives_the_truth_by_default():
    """The intervals of all parameters, the delay's among them, are right; interpolation moves it by ten errors."""
    found = flown_fit()
    scaled = np.array([(found.estimate[n] - TRUTH[n]) / found.standard_error[n] for n in FREE])
    assert np.abs(scaled).max() < 4.5
    assert np.sqrt(np.mean(scaled**2)) > 0.1
    assert "inputs     u held until the next sample, as the record says\n" in str(found)


def test_the_data_cannot_tell_and_the_delay_takes_half_a_sample(unknown, assumed):
    held = fitted(unknown, gb.OutputError(inputs="held"))
    assert held.cost == pytest.approx(assumed.cost, abs=1.0)
    shift = held.estimate["T_delay"] - assumed.estimate["T_delay"]
    assert shift == pytest.approx(-0.005, abs=3e-4)
    assert "as assumed without a hold; if wrong, delays change by half a step, 5 ms" in str(assumed)
    against = fitted(flown(), gb.OutputError(inputs="linear"))
    assert "as stated; if wrong, delays change by half a step, 5 ms" in str(against)


def test_records_that_know_and_do_not_know_have_a_line_each(unknown):
    halves = (unknown.between(0, 5), replace(unknown.between(5, 12), hold={"u": math.inf}))
    problem = gb.several(LinearTilt(), halves, free=["T_delay"])
    text = str(gb.fit(problem, [{name: TRUTH[name] for name in FREE}], progress=False))
    assert "u interpolated, as assumed without a hold" in text
    assert "u held until the next sample, as the record says" in text


def test_a_log_of_every_fourth_control():
    """Each value lasted for a quarter of a step: interpolated, an eighth of a step later."""
    fast = flown(controller=AttitudeController(rate=400))
    rows = np.arange(0, len(fast), 4)
    thinned = replace(fast.rows(rows), hold={**fast.hold, "u": 1 / 400})
    found = fitted(thinned)
    assert abs(found.estimate["T_delay"] - 0.01) < 3 * found.standard_error["T_delay"]
    assert found.records[0].between == {"u": "interpolated, 1.25 ms late, as the record says"}


def test_a_saved_fit_knows_it(tmp_path, assumed):
    found = flown_fit()
    for fit, name in ((found, "held"), (assumed, "assumed")):
        gb.save(fit, tmp_path / f"{name}.h5")
        loaded = gb.load(tmp_path / f"{name}.h5")
        assert loaded.records[0].between == fit.records[0].between
        assert loaded.records[0].data.hold == fit.records[0].data.hold
        assert str(loaded) == str(fit)


def test_simulation_and_prediction_follow_the_record_then_the_fit():
    """Of a lag, whose held and interpolated inputs have exact solutions by their steps."""
    time = np.arange(200) / 20
    u = np.sign(np.sin(2 * time))
    values = {"K": 3.0, "T": 0.4}

    def exact(hold):
        a, y = math.exp(-1 / 8), [0.0]
        mean = u[:-1] if hold else None
        for k in range(199):
            if hold:
                y.append(a * y[-1] + 3 * (1 - a) * mean[k])
            else:  # a ramp from u[k] to u[k + 1]
                slope = u[k + 1] - u[k]
                b = 1 - 8 * (1 - a)
                y.append(a * y[-1] + 3 * ((1 - a) * u[k] + b * slope))
        return np.array(y)

    unknown = gb.Record(time, {"u": u, "y": exact(hold=True)})
    known = replace(unknown, hold={"u": math.inf})
    held, linear = (gb.simulate(Lag(), values, record)["y"] for record in (known, unknown))
    assert_allclose(held, exact(hold=True), atol=1e-6)
    assert_allclose(linear, exact(hold=False), atol=1e-6)
    assert_allclose(gb.simulate(Lag(), values, known, inputs="linear")["y"], linear, atol=1e-9)
    windows = {"horizon": 1.0, "lead": 1.0}
    assert gb.predict(Lag(), values, known, **windows).rms("y") < 1e-5
    assert gb.predict(Lag(), values, unknown, **windows).rms("y") > 1e-2

    noisy = known.with_signals(y=known["y"] + 0.01 * np.random.default_rng(0).normal(size=200))
    fit = gb.fit(gb.Problem(Lag(), noisy), 3, progress=False)
    assert_allclose([fit.estimate["K"], fit.estimate["T"]], [3, 0.4], rtol=0.02)
    assert (
        gb.predict(fit, record=unknown, **windows).rms("y") < 0.02
    )  # the other record does not know: as in the fit


def late_lag(hold):
    """A lag of 0.2 s with a delay of 10 ms, whose input is held for 50 ms; its response and truth."""
    step, period, periods = 0.05, 200, 4
    random = np.random.default_rng(0)
    u = np.tile(random.normal(size=period), periods + 1)
    # Exact over a step: the value before acts for the delay.
    early, late = 1 - math.exp(-0.01 / 0.2), 1 - math.exp(-(step - 0.01) / 0.2)
    drive = np.append(0.0, u[:-1]) * early * (1 - late) + u * late
    y = np.zeros(len(u))
    for k in range(len(u) - 1):
        y[k + 1] = math.exp(-step / 0.2) * y[k] + drive[k]
    y += 1e-4 * random.normal(size=len(y))
    record = gb.Record(step * np.arange(len(u)), {"u": u, "y": y}, hold=hold)
    settled = record.between(period * step, record.time[-1])
    response = gb.spectral.periodic_response(settled, period * step, "u", "y")
    return response.where(response.omega < 6)


class LateLag(gb.TransferFunction):
    input, output = "u", "y"
    T = gb.Parameter(0.2, bounds=(0.01, 2.0))
    T_delay = gb.Parameter(0.01, bounds=(0.0, 0.5))

    def response(self, s, p):
        return gb.exp(-s * p.T_delay) / (p.T * s + 1)


def test_a_fit_divides_the_hold_out_of_a_response():
    response = late_lag({"u": math.inf})
    # The mean of the delays within the 50 ms for which a value lasts.
    times = 0.05 * (np.arange(1000) + 0.5) / 1000
    hold = np.exp(-1j * np.outer(response.omega, times)).mean(axis=1)
    assert_allclose(response.without_hold().response * hold, response.response, rtol=1e-6)
    delays = [
        gb.fit(gb.Problem(LateLag(), data), starts=1, progress=False).estimate["T_delay"]
        for data in (response, late_lag({}), late_lag({"u": math.inf, "y": math.inf}))
    ]
    assert_allclose(delays, [0.01, 0.035, 0.035], atol=1e-3)


def test_an_unstated_hold_of_a_response_is_said_with_what_it_does_to_delays(tmp_path):
    """Half a sample of 50 ms, as above; also in a file. A stated hold needs no word."""
    unstated = late_lag({"y": 0.0})
    gb.data.write_response(unstated, tmp_path / "unstated.csv")
    for data in (unstated, gb.read_response(tmp_path / "unstated.csv")):
        fit = gb.fit(gb.Problem(LateLag(), data), starts=1, progress=False)
        sentence = "of u not stated; if the input is held between its samples, delays are 25 ms"
        assert sentence in str(fit)
    for hold in ({"u": math.inf}, {"u": 0.0}, {"u": math.inf, "y": math.inf}):
        fit = gb.fit(gb.Problem(LateLag(), late_lag(hold)), starts=1, progress=False)
        assert "not stated" not in str(fit)


class Roll(gb.TransferFunction):
    """Roll rate from an aileron without a lag."""

    input, output = "aileron", "p"
    L = gb.Parameter(20.0, bounds=(1, 200))
    Lp = gb.Parameter(2.5, bounds=(0.1, 30))

    def response(self, s, p):
        return p.L / (s + p.Lp)


class ShortPeriod(gb.StateSpace):
    """Pitch rate and specific force, which an elevator reaches at once."""

    states, inputs, outputs = ("w", "q"), ("elevator",), ("q", "az")
    Zw = gb.Parameter(-1.2, bounds=(-9, 0))
    Zd = gb.Parameter(-8.0, bounds=(-99, 0))
    Mw = gb.Parameter(-0.4, bounds=(-9, 0))
    Mq = gb.Parameter(-2.0, bounds=(-20, 0))
    Md = gb.Parameter(-14.0, bounds=(-99, 0))

    def derivative(self, x, u, p):
        z = p.Zw * x.w + p.Zd * u.elevator
        return z + 15 * x.q, p.Mw * x.w + p.Mq * x.q + p.Md * u.elevator

    def output(self, x, u, p):
        return x.q, p.Zw * x.w + p.Zd * u.elevator


@pytest.mark.parametrize("model", [Roll(), ShortPeriod()], ids=["Roll", "ShortPeriod"])
def test_samples_of_outputs_without_a_lag_give_the_parameters(model):
    """Exact samples by the matrix exponential, up to an angle of one between two samples."""
    hold = 0.05
    omega = np.geomspace(0.5, 1 / hold, 30)
    truth = {name: parameter.start for name, parameter in model.parameters.items()}
    if isinstance(model, Roll):
        A, B, C, D = map(np.atleast_2d, (-2.5, 20.0, 1.0, 0.0))
    else:
        A, B = np.array([[-1.2, 15], [-0.4, -2]]), np.array([[-8.0], [-14.0]])
        C, D = np.array([[0, 1], [-1.2, 0]]), np.array([[0.0], [-8.0]])
    n = len(A)
    step = expm(hold * np.block([[A, B], [np.zeros((1, n + 1))]]))
    z = np.exp(1j * omega * hold)[:, None, None]
    exact = C @ np.linalg.solve(z * np.eye(n) - step[:n, :n], step[:n, n:]) + D
    data = [
        gb.FrequencyResponse(
            omega, values, model.input_names[0], output, about={"hold of the input, s": f"{hold}"}
        )
        for output, values in zip(model.output_names, exact[..., 0].T, strict=True)
    ]
    for problem in (gb.several(model, data), gb.Problem(model, data[-1])):
        fit = gb.fit(problem, starts=[truth], progress=False)
        assert_allclose([*fit.estimate.values()], [*truth.values()], rtol=1e-3)


class LateRoll(gb.StateSpace):
    """Roll and roll rate from an aileron whose servo is a delay."""

    states, inputs, outputs = ("p", "phi"), ("aileron",), ("p", "phi")
    delays = {"aileron": "T"}
    L = gb.Parameter(20.0, bounds=(1, 200))
    Lp = gb.Parameter(2.5, bounds=(0.1, 30))
    T = gb.Parameter(0.05, bounds=(0, 0.5))

    def derivative(self, x, u, p):
        return p.L * u.aileron - p.Lp * x.p, x.p

    def output(self, x, u, p):
        return x.p, x.phi


class LateRate(gb.TransferFunction):
    input, output = "aileron", "p"
    L, Lp, T = LateRoll.L, LateRoll.Lp, LateRoll.T

    def response(self, s, p):
        return p.L * gb.exp(-s * p.T) / (s + p.Lp)


def late_responses(late, hold=0.05):
    """Exact samples of `LateRoll`, whose aileron moves `late` holds after its values are written."""
    omega = np.geomspace(0.5, 16, 30)
    z, whole = np.exp(1j * omega * hold), math.ceil(late)
    after = hold * (late - whole + 1)  # the value before acts until then
    A, B = np.array([[-2.5, 0], [1, 0]]), np.array([[20.0], [0]])
    augmented = np.block([[A, B], [np.zeros((1, 3))]])
    first, second = expm(after * augmented), expm((hold - after) * augmented)
    early, drive = second[:2, :2] @ first[:2, 2:], second[:2, 2:]
    pencil = z[:, None, None] * np.eye(2) - second[:2, :2] @ first[:2, :2]
    # In the step after a sample, the value before the last one acts first.
    by_value = early + drive * z[:, None, None]
    samples = np.linalg.solve(pencil, by_value)[..., 0] * z[:, None] ** -whole
    about = {"hold of the input, s": f"{hold}"}
    return [
        gb.FrequencyResponse(omega, values, "aileron", output, about=about)
        for output, values in zip(LateRoll.outputs, samples.T, strict=True)
    ]


@pytest.mark.parametrize("late", [0.0, 0.2, 1.0, 2.8])
def test_the_fraction_of_a_sample_decides_what_is_folded_back(late):
    measured = late_responses(late)
    start = {"L": 18.0, "Lp": 3.0, "T": 0.05 * late + 0.004}
    for problem in (gb.several(LateRoll(), measured), gb.Problem(LateRate(), measured[0])):
        fit = gb.fit(problem, starts=[start], progress=False)
        values = [fit.estimate[name] for name in ("L", "Lp", "T")]
        # Of a hold, a thousandth.
        assert_allclose(values, [20, 2.5, 0.05 * late], rtol=1e-3, atol=5e-5)


class LateAcceleration(gb.TransferFunction):
    input, output = "aileron", "acceleration"
    L, Lp, T = LateRoll.L, LateRoll.Lp, LateRoll.T

    def response(self, s, p):
        return p.L * s / (s + p.Lp) * gb.exp(-s * p.T)


def test_a_delay_of_an_output_that_the_input_reaches_at_once_is_known_to_half_a_sample():
    """Samples show the aileron that acted before them: they are the same for 0.2 and 0.9 holds."""
    [rate, _] = late_responses(0.2)
    samples = 20 * np.exp(-1j * rate.omega * 0.05) - 2.5 * rate.response
    data = gb.FrequencyResponse(rate.omega, samples, "aileron", "acceleration", about=rate.about)
    fit = gb.fit(gb.Problem(LateAcceleration(), data), starts=2, progress=False)
    assert abs(fit.estimate["T"] - 0.01) > 3 * fit.standard_error["T"]
    assert any("Fit the record itself" in text for text in fit.warnings)
    fit = gb.fit(gb.Problem(LateRate(), rate), starts=2, progress=False)
    assert not any("Fit the record itself" in text for text in fit.warnings)


def test_a_figure_shows_the_samples_that_were_fitted():
    [rate, _] = late_responses(1.0)
    fit = gb.fit(gb.Problem(LateRate(), rate), starts=1, progress=False)
    curve, omega = fit.parts[0].curve, rate.omega
    drawn = np.interp(omega, curve.omega, np.abs(curve.response))
    assert_allclose(drawn, np.abs(fit.parts[0].response), rtol=2e-3)
    # Samples enlarge the gain of a rate by (ωh)²/12, 5 % at the end.
    assert abs(fit.response(omega[-1:]).response[0]) < 0.97 * drawn[-1]


def test_manoeuvres_of_held_inputs_give_the_parameters():
    """A rate and a specific force, which the elevator reaches at once, from their Fourier integrals."""
    step = 0.05
    u = np.repeat([0, 1, -1, 0.5, 0, 0, 0, 0], 20).astype(float)
    record = gb.Record(step * np.arange(u.size), {"elevator": u}, hold={"elevator": np.inf})
    model = ShortPeriod()
    truth = {name: parameter.start for name, parameter in model.parameters.items()}
    flown = record.with_signals(**gb.simulate(model, truth, record).signals)
    spectrum = gb.spectral.transient_spectrum(flown, "elevator", ("q", "az"), (0.5, 16))
    start = {name: 1.1 * value for name, value in truth.items()}
    fit = gb.fit(gb.Problem(model, spectrum), starts=[start], progress=False)
    assert_allclose([*fit.estimate.values()], [*truth.values()], rtol=2e-3)


def test_the_rate_of_a_sampled_angle_is_not_that_of_a_sampled_rate():
    hold, s = 0.05, 1j * np.geomspace(0.5, 16, 30)
    # Exact samples of 20 / (s (s + 2.5)) behind a hold.
    z, decay = np.exp(s * hold), np.exp(-2.5 * hold)
    angle = 20 / 2.5 * (hold / (z - 1) - (1 - decay) / 2.5 / (z - decay))
    about = {"hold of the input, s": f"{hold}"}
    rate = gb.FrequencyResponse(s.imag, angle, "aileron", "phi", about=about).times_s("p")
    fit = gb.fit(gb.Problem(Roll(), rate), starts=2, progress=False)
    assert_allclose([fit.estimate["L"], fit.estimate["Lp"]], [20, 2.5], rtol=1e-3)


class Proportional(gb.Controller):
    inputs, outputs = ("y",), ("u",)

    def update(self, x, u, p):
        return (), (3.0 * (u.reference - u.y),)


def test_margins_count_the_hold_of_a_fitted_response_once():
    law, data = Proportional(rate=20), late_lag({"u": math.inf})
    fit = gb.fit(gb.Problem(LateLag(), data), starts=1, progress=False)
    truth = gb.margins(LateLag(), law)["phase margin"].value
    assert gb.margins(fit, law)["phase margin"].value == pytest.approx(truth, abs=1.0)


class DelayedLag(gb.TransferFunction):
    """A lag with a delay."""

    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0, 10))
    T = gb.Parameter(1.0, bounds=(0, 10), unit="s")
    tau = gb.Parameter(0.05, bounds=(0, 1), unit="s")

    def response(self, s, p):
        return p.K / (p.T * s + 1) * gb.exp(-p.tau * s)


@pytest.mark.parametrize(
    ("about", "late", "grade"),
    [
        # With an unknown interval it may be 79 ms or a tenth of one: a remark, no doubt.
        ({}, "up to 79 ms", "good"),
        ({"hold of the input not stated; sampling interval, s": "0.02"}, "10 ms", "doubt"),
        ({"hold of the input not stated; sampling interval, s": "0.0001"}, "", "good"),
        ({"hold of the input, s": "0.02"}, "", "good"),
        ({"hold of the input, s": "0"}, "", "good"),
    ],
)
def test_a_delay_of_a_response_whose_hold_nobody_states_is_in_doubt(about, late, grade):
    omega = np.geomspace(0.5, 20, 20)
    random = np.random.default_rng(0)
    errors = 1 + 0.01 * random.normal(size=(20, 2)) @ [1, 1j]
    exact = 2 * np.exp(-0.1j * omega) / (0.5j * omega + 1)
    data = gb.FrequencyResponse(omega, exact * errors, "u", "y", about=about)
    fit = gb.fit(gb.Problem(DelayedLag(), data), starts=2, progress=False)
    said = [text for text in (*fit.warnings, *fit.notes) if "half a sample" in text]
    assert len(said) == bool(late)
    assert not late or f"contains half a sample, {late}, which" in said[0]
    assert verdict(fit).grade == grade
    assert bool(fit.warnings) == (grade == "doubt")
    # A model without a delay has nothing to doubt.
    fixed = gb.Problem(DelayedLag(), data, fixed={"tau": 0.1})
    assert not any("half a sample" in w for w in gb.fit(fixed, starts=2, progress=False).warnings)
