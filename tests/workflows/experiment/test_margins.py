"""Margins of loops, held against python-control, virtual flights and many noisy fits."""

import control
import numpy as np
import pytest
from rate_control import RATE, RateDynamics, RateLoop
from scipy.optimize import brentq

import greybox as gb
from greybox.models.ardupilot import AngleController, RateController
from greybox.problems import yaw_hover
from greybox.workflows.experiment.sampled_loop import sampled_loop

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {"K": 40.0, "a": 2.0, "T": 0.05, "tau": 0.023}
OMEGA = np.geomspace(1, 40, 30)


def fitted(seed, noise=0.03, model=None, omega=OMEGA):
    exact = gb.frequency_response(RateDynamics(), TRUTH, omega).response
    errors = noise * np.random.default_rng(seed).normal(size=(2, omega.size))
    data = gb.FrequencyResponse(omega, exact * (1 + errors[0] + 1j * errors[1]), "u", "q")
    return gb.fit(gb.Problem(model or RateDynamics(), data), starts=2, progress=False)


@pytest.fixture(scope="module")
def fit():
    return fitted(0)


def in_python_control(values, gains):
    """The broken loop of python-control: plant by zero-order hold, whole samples of delay, controller."""
    numerator, denominator = [values["K"]], np.polymul([1, values["a"]], [values["T"], 1])
    plant = control.c2d(control.tf(numerator, denominator), 1 / RATE)
    delay = control.tf([1], [1, *[0] * round(values["tau"] * RATE)], 1 / RATE)
    law = control.tf([gains["K_P"], gains["K_I"] / RATE - gains["K_P"]], [1, -1], 1 / RATE)
    return plant * delay * law


def phase_margin(loop):
    """The smallest one, degrees, by python-control's response: its roots of polynomials are less exact."""

    def at(omega):
        return loop(np.exp(1j * omega / RATE))

    def excess(omega):
        return np.log(np.abs(at(omega)))

    grid = np.geomspace(1e-4, 0.999 * np.pi * RATE, 2000)
    (places,) = np.nonzero(np.diff(np.sign(excess(grid))))
    crossings = [brentq(excess, *grid[k : k + 2], xtol=1e-13) for k in places]
    angles = [180 - abs(np.degrees(np.angle(at(omega)))) for omega in crossings]
    return min(angles, default=np.inf)


def test_margins_are_those_of_python_control():
    rng = np.random.default_rng(3)
    compared = 0
    for _ in range(12):
        values = {
            "K": rng.uniform(5, 80),
            "a": rng.uniform(-3, 10),
            "T": rng.uniform(0.02, 0.2),
            "tau": rng.integers(0, 5) / RATE,
        }
        gains = {"K_P": rng.uniform(0.02, 0.4), "K_I": rng.uniform(0, 1)}
        exact = gb.margins(RateDynamics(), RateLoop(gains), values)
        loop = in_python_control(values, gains)
        poles = control.feedback(loop, 1).poles()
        assert exact.is_stable == bool(np.all(np.abs(poles) < 1))
        if not exact.is_stable:
            continue
        compared += 1
        gain, *_ = control.stability_margins(loop, returnall=True, method="poly")
        larger = gain[gain > 1]
        expected = 20 * np.log10(larger.min()) if larger.size else np.inf
        assert exact["gain margin"].value == pytest.approx(expected, rel=1e-8)
        expected = phase_margin(loop)
        assert exact["phase margin"].value == pytest.approx(expected, rel=1e-8)
        modulus = exact["modulus margin"]
        omega = np.union1d(np.geomspace(0.1, 0.999 * np.pi * RATE, 300), modulus.omega)
        disk, *_ = control.disk_margins(loop, omega, skew=1.0)
        assert modulus.value == pytest.approx(disk, rel=1e-8)
    assert compared > 4


def test_a_crossover_far_below_the_rate_of_the_loop_counts():
    values, gains = {"K": 25.6, "a": 6.2, "T": 0.083, "tau": 3 / RATE}, {"K_P": 0.094, "K_I": 2e-3}
    margin = gb.margins(RateDynamics(), RateLoop(gains), values)["phase margin"]
    there = in_python_control(values, gains)(np.exp(1j * margin.omega / RATE))
    assert margin.omega < 0.02
    assert np.abs(there) == pytest.approx(1, abs=1e-6)
    assert margin.value == pytest.approx(180 - np.abs(np.degrees(np.angle(there))), abs=1e-4)


@pytest.mark.parametrize(("margin", "sign"), [("gain margin", 1), ("gain reduction margin", -1)])
def test_a_flight_diverges_where_the_gain_margin_is_used_up(margin, sign):
    values = {**TRUTH, "a": -2.0}  # unstable without its loop
    found = gb.margins(RateDynamics(), RateLoop(), values)[margin].value
    assert np.isfinite(found)
    kick = {"u": np.r_[1.0, np.zeros(3000)]}
    growth = []
    for share in (0.97, 1.03):
        gain = values["K"] * 10 ** (sign * share * found / 20)
        flight = gb.virtual_flight(
            RateDynamics(), {**values, "K": gain}, kick, controller=RateLoop()
        )
        q = np.abs(flight["q"])
        growth.append(q[-500:].max() / q[1000:1500].max())
    assert growth[0] < 1 < growth[1]


class Gain(gb.Controller):
    """Proportional control of the rate."""

    inputs, outputs, rate = ("q",), ("u",), RATE
    K_P = gb.Parameter(0.5)

    def update(self, x, u, p):
        return (), (p.K_P * (u.reference - u.q),)


class FirstOrder(gb.TransferFunction):
    """A lag, unstable where a is negative."""

    input, output = "u", "q"
    K = gb.Parameter(4.0)
    a = gb.Parameter(2.0)

    def response(self, s, p):
        return p.K / (s + p.a)


@pytest.mark.parametrize("a", [-0.5, 2.0, 60.0])
def test_a_gain_that_is_real_at_rest_and_at_half_the_rate_counts(a):
    """The pole of the loop, z = e^(-a h) - k b, is one at rest and -1 at the Nyquist frequency."""
    decay = np.exp(-a / RATE)
    b = 0.5 * 4.0 * (1 - decay) / a
    answer = gb.margins(FirstOrder(), Gain(), {"a": a})
    assert answer["gain margin"].value == pytest.approx(20 * np.log10((1 + decay) / b), rel=1e-4)
    reduction = 20 * np.log10(b / (decay - 1)) if a < 0 else np.inf
    assert answer["gain reduction margin"].value == pytest.approx(reduction, rel=1e-4)
    assert answer["gain margin"].omega == pytest.approx(np.pi * RATE)


def test_two_integrators_have_no_gain_reduction_margin():
    class Position(gb.TransferFunction):
        input, output = "u", "q"
        K = gb.Parameter(4.0)

        def response(self, s, p):
            return p.K * (s + 1) / s**2

    assert gb.margins(Position(), Gain())["gain reduction margin"].value == np.inf


@pytest.mark.usefixtures("few_draws")
def test_a_resonance_narrower_than_the_spacing_of_frequencies_counts_in_every_draw():
    """A structural mode with 0.3 % of critical damping: its peak limits the gain."""

    class Flexible(gb.TransferFunction):
        input, output = "u", "q"
        K = gb.Parameter(3.0, bounds=(0.1, 30))
        w = gb.Parameter(20.0, bounds=(15, 25))
        zeta = gb.Parameter(0.003, bounds=(1e-4, 0.1))

        def response(self, s, p):
            mode = p.w**2 / (s**2 + 2 * p.zeta * p.w * s + p.w**2)
            return p.K / s * mode * gb.exp(-0.055 * s)

    omega = np.r_[np.geomspace(0.03, 40, 20), np.linspace(19.8, 20.2, 30)]
    exact = gb.frequency_response(Flexible(), {}, omega).response
    errors = 0.01 * np.random.default_rng(0).normal(size=(2, omega.size))
    data = gb.FrequencyResponse(omega, exact * (1 + errors[0] + 1j * errors[1]), "u", "q")
    problem = gb.Problem(Flexible(), data)
    fit = gb.fit(problem, starts=[{}], profiles=False, progress=False)
    law = Gain({"K_P": 0.03}, rate=200)
    margin = gb.margins(fit, law)["gain margin"]
    assert 0.9 * margin.value < margin.low < margin.value < margin.high < 1.1 * margin.value
    # A set of gains is judged by the same peak: 6 dB remain up to this gain.
    limit = 0.03 * 10 ** ((margin.value - 6) / 20)
    safe = gb.safe_gains(fit, law, {"K_P": (limit / 1.5, 1.5 * limit)}, phase_margin=0)
    assert 0.9 * limit < safe.values["K_P"][safe.allowed].max() < limit


def test_a_negative_delay_is_refused():
    with pytest.raises(ValueError, match=r"the delay of 'u' is -0\.1 s: give a value of 0 or more"):
        gb.margins(RateDynamics(), RateLoop(), {**TRUTH, "tau": -0.1})


def test_gains_of_the_closed_loop_are_those_of_a_sampled_lag():
    class Lag(gb.StateSpace):
        states, inputs, outputs = ("y",), ("u",), ("y",)
        K = gb.Parameter(3.0)
        T = gb.Parameter(0.5)

        def derivative(self, x, u, p):
            return ((p.K * u.u - x.y) / p.T,)

        def output(self, x, u, p):
            return (x.y,)

    class Proportional(gb.Controller):
        inputs, setpoints, outputs, rate = ("y",), ("r",), ("u",), 50.0

        def update(self, x, u, p):
            return (), (1.5 * (u.r - u.y),)

    omega = np.array([2.0, 4.25, 9.0])
    z, a = np.exp(1j * omega / 50), np.exp(-1 / 50 / 0.5)
    plant = 3 * (1 - a) / (z - a)
    loop = sampled_loop(Lag(), np.array([[3.0, 0.5]]), Proportional())
    expected = np.array([plant, np.ones(3)]) * 1.5 / (1 + 1.5 * plant)
    gains = loop.gains("r", ["y", "u"], omega)[0].T
    assert gains == pytest.approx(expected, rel=1e-12)
    assert loop.broken_at("u", omega)[0] == pytest.approx(1.5 * plant, rel=1e-12)
    alone = sampled_loop(Lag(), np.array([[3.0, 0.5]]), None, rate=50.0)
    assert alone.gains("u", ["y"], omega)[0, :, 0] == pytest.approx(plant, rel=1e-12)


@pytest.mark.usefixtures("few_draws")
def test_intervals_cover_the_true_margins_and_are_as_wide_as_the_scatter():
    # A measured response has the delay of the hold of its control.
    truth = gb.margins(RateDynamics(), RateLoop(), {**TRUTH, "tau": TRUTH["tau"] - 0.5 / RATE})
    answers = [gb.margins(fitted(seed), RateLoop()) for seed in range(8)]
    names = "phase margin, gain margin, delay margin, modulus margin, crossover, bandwidth, "
    names += "disturbance rejection peak, -180 deg frequency, overshoot, rise time, damping ratio"
    for name in names.split(", "):
        low, value, high = np.array([(a[name].low, a[name].value, a[name].high) for a in answers]).T
        assert np.sum((low <= truth[name].value) & (truth[name].value <= high)) >= 6
        # Errors of the first response look correlated by chance, and its intervals are wider.
        half_width = np.median(high - low) / 2
        assert 1.2 < half_width / np.std(value, ddof=1) < 3.4


def test_intervals_follow_the_profile_where_errors_are_not_symmetric():
    omega = np.geomspace(1, 40, 12)
    exact = gb.frequency_response(RateDynamics(), TRUTH, omega).response
    errors = 0.5 * np.random.default_rng(4).normal(size=(2, omega.size))
    data = gb.FrequencyResponse(omega, exact * (1 + errors[0] + 1j * errors[1]), "u", "q")
    values = {name: TRUTH[name] for name in ("K", "a", "tau")}
    fit = gb.fit(gb.Problem(RateDynamics(), data, fixed=values), starts=2, progress=False)
    ends = gb.profile(fit, "T").intervals["T"]
    # The longer the lag, the smaller the phase margin.
    high, low = (
        gb.margins(RateDynamics(), RateLoop(), {**TRUTH, "T": T, "tau": TRUTH["tau"] - 0.5 / RATE})
        for T in ends
    )
    margin = gb.margins(fit, RateLoop())["phase margin"]
    width = margin.high - margin.low
    assert margin.low == pytest.approx(low["phase margin"].value, abs=0.03 * width)
    assert margin.high == pytest.approx(high["phase margin"].value, abs=0.03 * width)
    # By the standard error alone, the upper end would be elsewhere.
    linear = fit.interval()["T"]
    assert abs(linear[0] - ends[0]) > 0.1 * (ends[1] - ends[0])


def test_intervals_of_a_record_follow_the_profile_too():
    values = {**TRUTH, "tau": 0.02}
    kick = {"u": np.r_[0.1 * np.sign(np.sin(4 * np.arange(300) / RATE)), np.zeros(100)]}
    record = gb.virtual_flight(RateDynamics(), values, kick, rate=RATE, noise={"q": 3.0}, seed=1)
    fixed = {name: values[name] for name in ("K", "T", "tau")}
    fit = gb.fit(gb.Problem(RateDynamics(), record, fixed=fixed), starts=2, progress=False)
    # The faster the damping, the larger the phase margin.
    low, high = (
        gb.margins(RateDynamics(), RateLoop(), {**values, "a": a})["phase margin"].value
        for a in gb.profile(fit, "a").intervals["a"]
    )
    margin = gb.margins(fit, RateLoop())["phase margin"]
    assert margin.low == pytest.approx(low, abs=0.04 * (high - low))
    assert margin.high == pytest.approx(high, abs=0.04 * (high - low))
    linear = fit.interval()["a"][0]
    by_error = gb.margins(RateDynamics(), RateLoop(), {**values, "a": linear})["phase margin"]
    assert margin.low - by_error.value > 0.08 * (high - low)


def test_intervals_of_a_precise_record_are_those_of_its_covariance():
    values = {**TRUTH, "tau": 0.02}
    kick = {"u": np.r_[0.1 * np.sign(np.sin(4 * np.arange(300) / RATE)), np.zeros(100)]}
    record = gb.virtual_flight(RateDynamics(), values, kick, rate=RATE, noise={"q": 0.1}, seed=1)
    fixed = {name: values[name] for name in ("K", "tau")}
    fit = gb.fit(gb.Problem(RateDynamics(), record, fixed=fixed), starts=1, progress=False)
    assert abs(fit.correlation[0, 1]) > 0.3

    def phase_margin(name, step):
        at = {**fit.estimate, name: fit.estimate[name] + step}
        return gb.margins(RateDynamics(), RateLoop(), at)["phase margin"].value

    errors = [fit.standard_error[name] for name in fit.free]
    slopes = [
        (phase_margin(name, error) - phase_margin(name, -error)) / 2
        for name, error in zip(fit.free, errors, strict=True)
    ]
    deviation = np.sqrt(slopes @ fit.correlation @ slopes)
    margin = gb.margins(fit, RateLoop())["phase margin"]
    assert margin.high - margin.low == pytest.approx(2 * 1.98 * deviation, rel=0.1)


@pytest.mark.usefixtures("few_draws")
def test_a_pole_that_cannot_pass_zero_makes_no_draw_unstable():
    # 300 bootstrap replicates are stable, although the standard error of a2 is twice its value.
    fit = gb.fit(yaw_hover.problem(), starts=2, profiles=False, progress=False)
    assert fit.standard_error["a2"] > fit.estimate["a2"]
    gains = {"P": 0.18, "I": 0.018, "D": 0.0, "FLTE": 2.5}
    rate = RateController(gains, signals={"q": "psi_dot"})
    answer = gb.margins(fit, [AngleController(signals={"theta": "psi"}), rate])
    assert answer.is_safe
    assert 30 < answer["phase margin"].low < answer["phase margin"].high < 80


@pytest.mark.usefixtures("few_draws")
def test_the_answer_begins_with_the_margins_and_names_what_is_extrapolated(fit):
    text = str(gb.margins(fit, RateLoop()))
    assert text.startswith("The loop of RateDynamics, broken at u, has a phase margin of")
    narrow = gb.margins(fitted(0, omega=np.geomspace(0.5, 3, 30)), RateLoop())
    assert narrow["crossover"].is_extrapolated
    assert "extrapolated" in narrow.verdict
    assert not gb.margins(fit, RateLoop())["crossover"].is_extrapolated
    downward = gb.margins(fitted(0, omega=OMEGA[::-1]), RateLoop())
    assert not downward["crossover"].is_extrapolated


def test_an_unstable_loop_has_no_margins(fit):
    answer = gb.margins(fit, RateLoop({"K_P": 5.0}))
    assert not answer.is_stable
    assert answer.margins == ()
    assert "unstable" in answer.verdict
    assert answer.to_dict()["stable"] is False


@pytest.mark.usefixtures("few_draws")
def test_a_loop_that_may_be_unstable_has_a_probability_and_no_interval(fit):
    limit = 10 ** (gb.margins(fit, RateLoop())["gain margin"].value / 20)
    answer = gb.margins(fit, RateLoop({"K_P": 0.15 * 0.99 * limit, "K_I": 0.3 * 0.99 * limit}))
    assert 0.1 < answer.instability < 0.9
    assert np.isnan(answer["phase margin"].low)
    assert "unstable with a probability" in answer.verdict


class TwoGains(RateDynamics):
    """The gain is a product of which the data determine nothing more."""

    L = gb.Parameter(1.0, bounds=(0.01, 100))

    def response(self, s, p):
        return p.L * super().response(s, p)


def test_what_the_data_do_not_determine_matters_only_where_it_is_felt(fit):
    answer = gb.margins(fitted(0, model=TwoGains()), RateLoop())
    # The loop feels the product alone, and the warnings of the fit are passed on.
    assert not any("No interval" in note for note in answer.notes)
    assert answer.notes
    assert answer["phase margin"].low == pytest.approx(
        gb.margins(fit, RateLoop())["phase margin"].low, rel=0.05
    )


class Unseen(gb.StateSpace):
    """The rate is fed back through a gain that a measurement of the angular momentum lacks."""

    states, inputs, outputs = ("h",), ("u",), ("h", "q")
    K = gb.Parameter(40.0, bounds=(1, 1000))
    a = gb.Parameter(2.0, bounds=(0, 50))
    c = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return (p.K * u.u - p.a * x.h,)

    def output(self, x, u, p):
        return (x.h, p.c * x.h)


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("fixed", [{}, {"a": 3.0}])
def test_a_loop_that_feels_what_the_data_do_not_determine_has_no_interval(fixed):
    response = 35 / (1j * OMEGA + 3) * (1 + 0.01 * np.exp(1j * 7 * OMEGA))
    data = gb.FrequencyResponse(OMEGA, response, input="u", output="h")
    problem = gb.Problem(Unseen(), data, fixed=fixed)
    fit = gb.fit(problem, starts=2, profiles=False, progress=False)
    answer = gb.margins(fit, RateLoop())
    assert any("do not determine the phase margin" in note for note in answer.notes)
    assert np.isnan(answer["phase margin"].low)


def test_a_table_of_loops_has_their_main_margins_and_the_risk_of_instability():
    stable, unstable = (
        gb.margins(RateDynamics(), RateLoop(gains), TRUTH) for gains in ({}, {"K_P": 5.0})
    )
    header, _, first, second = gb.experiment.margin_table(
        [("hover", stable), ("climb", unstable)]
    ).splitlines()
    names = ["phase margin, deg", "gain margin, dB", "delay margin, s", "crossover, rad/s"]
    assert sorted(names, key=header.index) == names
    assert all(name in header for name in names)
    values = [stable[name.split(",")[0]].value for name in names]
    assert [float(cell) for cell in first.split()[2:6]] == pytest.approx(values, rel=5e-3)
    assert second.split() == ["climb", "u", "-", "-", "-", "-", "100"]


def test_signals_that_are_not_in_the_loop_are_refused(fit):
    with pytest.raises(ValueError, match="the loop has no signal 'theta'; it has q"):
        gb.margins(fit, RateLoop(), broken_at="theta")
    with pytest.raises(ValueError, match="level"):
        gb.margins(fit, RateLoop(), level=95)
    with pytest.raises(TypeError, match=r"loop is <Fit .*: give the FrequencyResponse of a broken"):
        gb.experiment.measured_margins(fit)
    for tracking in ("q", ("reference",)):
        with pytest.raises(ValueError, match="give two names"):
            gb.margins(fit, RateLoop(), tracking=tracking)
    for part in (9, 0.5):
        with pytest.raises(ValueError, match=f"fit with 1 part is {part}: give a whole number"):
            gb.margins(fit, RateLoop(), part=part)


@pytest.mark.usefixtures("few_draws")
def test_the_uncertainty_holds_the_true_loop_and_grows_outside_the_data(fit):
    omega = np.geomspace(1, 200, 20)
    radius = gb.margins(fit, RateLoop()).uncertainty(omega)
    loop = gb.margins(fit, RateLoop()).loop.first.broken_at("u", omega)[0]
    values = {**TRUTH, "tau": TRUTH["tau"] - 0.5 / RATE}
    truth = gb.margins(RateDynamics(), RateLoop(), values).loop.broken_at("u", omega)[0]
    assert np.mean(np.abs(truth / loop - 1) < 1.5 * radius) > 0.9
    assert radius[-1] > 2 * radius[np.searchsorted(omega, 10)]
    assert np.isnan(gb.margins(RateDynamics(), RateLoop()).uncertainty(omega)).all()


class Drag(gb.StateSpace):
    """Yaw rate under a torque and quadratic drag."""

    states, inputs, outputs = ("q",), ("u",), ("q",)
    drag = gb.Parameter(0.2, bounds=(0.01, 2))

    def derivative(self, x, u, p):
        return (5 * u.u - p.drag * abs(x.q) * x.q,)

    def output(self, x, u, p):
        return (x.q,)


def test_a_fitted_manoeuvre_is_closed_about_the_point_of_its_fit():
    t, spin = 0.05 * np.arange(200), {"q": 5.0}
    u = 1.5 + 0.02 * np.sign(np.sin(0.9 * t)) * (t < 8)
    flown = gb.Record(t, {"u": u})
    clean = gb.simulate(Drag(), {"drag": 0.3}, flown, initial=spin)["q"]
    noise = 2e-3 * np.random.default_rng(2).normal(size=len(t))
    flown = flown.with_signals(q=clean + noise)
    spectrum = gb.spectral.transient_spectrum(flown, "u", "q", (0.6, 6.0))
    fit = gb.fit(gb.Problem(Drag(), spectrum, at=spin), [{}], profiles=False, progress=False)
    answer, expected = (
        gb.margins(fit, RateLoop()),
        gb.margins(Drag(), RateLoop(), fit.estimate, at=spin),
    )
    at_rest = gb.margins(Drag(), RateLoop(), fit.estimate)
    assert answer["phase margin"].value == pytest.approx(expected["phase margin"].value)
    assert expected["phase margin"].value != pytest.approx(at_rest["phase margin"].value, rel=0.1)
