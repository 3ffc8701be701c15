"""Planned tests keep what they promise when they are flown: errors, limits, time."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay

import greybox as gb
from greybox.models.controller import AttitudeController
from greybox.models.tilt import NonlinearTilt
from greybox.workflows.experiment import expected_errors, plan_sines
from greybox.workflows.experiment.shortest_flight import with_spare_sines
from greybox.workflows.experiment.sine_plan import QUIET_PERIODS, noise_density

pytestmark = pytest.mark.usefixtures("unjudged_file")

TILT = {"a1": -14.6, "a2": 3.0, "a3": 8.5, "a4": 295.0}
RATE = 100  # Hz
NOISE = 0.002  # rad


class Lag(gb.TransferFunction):
    """A lag."""

    input, output = "u", "y"
    K = gb.Parameter(2.0, bounds=(0.1, 20), unit="1/s")
    tau = gb.Parameter(0.3, bounds=(0.01, 3), unit="s")

    def response(self, s, p):
        return p.K / (p.tau * s + 1)


LAG = {"K": 2.0, "tau": 0.3}
OPEN_LOOP = {
    "input": "u",
    "output": "y",
    "excitation": "u",
    "unit": "1",
    "rate": 50.0,
    "band": (0.5, 15),
}


@pytest.fixture(scope="module")
def lag():
    return plan_sines(
        Lag(), LAG, {"K": 0.003, "tau": 0.001}, amplitude=0.5, noise=0.05, **OPEN_LOOP
    )


@pytest.fixture(scope="module")
def tilt():
    return plan_sines(
        NonlinearTilt(),
        TILT,
        {"a2": 0.05, "a4": 2.0},
        band=(0.8, 30),
        amplitude=0.03,
        noise=NOISE,
        controller=AttitudeController(rate=RATE),
        limits={"theta": 0.02, "theta_dot": 0.1},
        fixed={"C_x": 0.05},
    )


def test_repeated_flights_scatter_by_the_expected_errors(lag):
    assert all(lag.standard_error[name] <= error * 1.0001 for name, error in lag.wanted.items())
    time = np.arange(round(lag.flight_time * 50) + 50) / 50
    excitation = lag.excitation()
    u = np.interp(time, excitation.time, excitation.signals["u"])
    clean = gb.simulate(Lag(), LAG, gb.Record(time, {"u": u}))["y"]
    random = np.random.default_rng(1)
    scores = []
    for _ in range(4):
        record = gb.Record(time, {"u": u, "y": clean + 0.05 * random.normal(size=time.size)})
        found = gb.fit(gb.Problem(Lag(), record), [LAG], progress=False)
        scores.append([(found.estimate[k] - LAG[k]) / lag.standard_error[k] for k in LAG])
    # 8 numbers: their rms is known to 25 %. The record has the sines while they settle, too.
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.4


def test_the_flight_time_is_that_of_the_schedule(lag):
    excitation = lag.excitation()
    assert excitation.time[-1] == pytest.approx(lag.flight_time, abs=0.05)
    assert [m.end - m.settled for m in excitation.schedule] == pytest.approx(lag.duration)
    assert len(lag.omega) == 3  # six numbers, two parameters


def test_half_of_the_errors_take_four_times_as_long(lag):
    half = {name: error / 2 for name, error in lag.standard_error.items()}
    found = plan_sines(Lag(), LAG, half, amplitude=0.5, noise=0.05, **OPEN_LOOP)
    assert found.duration.sum() == pytest.approx(4 * lag.duration.sum(), rel=0.15)


def flight_time_of(omega, wanted):
    """The shortest time of three sines in open loop, in whole periods, by its closed formulas."""
    s = 1j * omega
    slopes = np.array([1 / (0.3 * s + 1), -2.0 * s / (0.3 * s + 1) ** 2]).T
    scaled = slopes * [wanted["K"], wanted["tau"]]
    second = 0.5**2 * 50 / (2 * 0.05**2) * np.real(scaled.conj()[:, :, None] * scaled[:, None, :])
    period = 2 * np.pi / omega
    overhead = np.ceil(2 / period) * period + 2.0
    best = np.inf
    for shares in np.random.default_rng(0).dirichlet(np.ones(3), 30):
        # Times in these shares, but ten periods of each at least.
        for scale in np.geomspace(10, 1000, 40):
            seconds = np.maximum(np.ceil(shares * scale / period), 10) * period
            variances = np.diag(np.linalg.inv(np.tensordot(seconds, second, 1)))
            if max(variances) <= 1:
                best = min(best, np.sum(seconds + overhead) + 2.0)
                break
    return best


def test_no_other_sines_make_a_shorter_flight():
    """Against random choices of three frequencies in the band, and the best of some times for each."""
    wanted = {"K": 0.0024, "tau": 0.0008}
    planned = plan_sines(Lag(), LAG, wanted, amplitude=0.5, noise=0.05, **OPEN_LOOP)
    random = np.random.default_rng(3)
    times = []
    for _ in range(100):
        omega = np.sort(np.exp(random.uniform(np.log(0.5), np.log(15), 3)))
        if np.all(omega[1:] / omega[:-1] > 2 ** (1 / 3)):
            times.append(flight_time_of(omega, wanted))
    assert len(times) > 30
    assert planned.flight_time < min(times)
    assert planned.flight_time > 0.7 * min(times)


def test_tighter_wishes_take_longer():
    """Least periods make a flight that reaches more than is wanted: it serves looser wishes, too."""
    times = []
    for share in (0.4, 0.6, 0.8, 1.0, 1.3, 1.7, 2.5, 4.0):
        wanted = {"K": 0.003 * share, "tau": 0.001 * share}
        planned = plan_sines(Lag(), LAG, wanted, amplitude=0.5, noise=0.05, **OPEN_LOOP)
        assert all(planned.standard_error[name] <= 1.0001 * wanted[name] for name in wanted)
        times.append(planned.flight_time)
    assert times == sorted(times, reverse=True)


def test_the_limits_are_kept_in_flight(tilt):
    excitation = tilt.excitation()
    flown = gb.virtual_flight(
        NonlinearTilt(),
        TILT,
        excitation,
        controller=AttitudeController(rate=RATE),
        noise={"theta_dot": 0.0},
    )
    reached = {"reference": 0.0, "theta": 0.0, "theta_dot": 0.0}
    for sine in excitation.schedule:
        inside = (flown.time > sine.settled) & (flown.time < sine.end)
        for name, before in reached.items():
            size = np.ptp(flown[name][inside]) / 2
            reached[name] = max(before, size)
    most = {"reference": 0.03, "theta": 0.02, "theta_dot": 0.1}
    assert all(reached[name] < 1.05 * most[name] for name in most)
    assert any(reached[name] > 0.9 * most[name] for name in most)
    assert set(tilt.limited_by) <= set(most)


def test_a_quiet_flight_says_how_large_the_noise_is(tilt):
    quiet = gb.virtual_flight(
        NonlinearTilt(),
        TILT,
        {"reference": np.zeros(6000)},
        controller=AttitudeController(rate=RATE),
        noise={"theta": NOISE},
        seed=3,
    )
    found = plan_sines(
        NonlinearTilt(),
        TILT,
        tilt.wanted,
        band=(0.8, 30),
        amplitude=0.03,
        noise=quiet,
        controller=AttitudeController(rate=RATE),
        limits={"theta": 0.02, "theta_dot": 0.1},
        fixed={"C_x": 0.05},
    )
    # A sine of low frequency that looks a little better takes many seconds more.
    assert 0.5 < found.flight_time / tilt.flight_time < 2


def test_expected_errors_are_those_of_a_fit_that_ends_there():
    omega, model, values = TWO_LAGS_OMEGA, LagLagDelay(), TWO_LAGS
    exact = gb.frequency_response(model, values, omega).response
    data = gb.FrequencyResponse(
        omega, exact, input="u", output="y", variance=(0.02 * np.abs(exact)) ** 2
    )
    problem = gb.Problem(model, data, gb.MaximumLikelihood())
    expected = expected_errors(problem, values)
    found = gb.fit(problem, [values], progress=False)
    for name, error in expected.standard_error.items():
        assert error == pytest.approx(found.standard_error[name], rel=1e-3)
    assert "percent" in str(expected)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"band": (5, 2)}, "the lower one first"),
        ({"band": (0, 2)}, "the value of band\\[0\\], 0, must be a positive number"),
        ({"wanted": {}}, r"wanted is \{\}: give \{parameter: standard error\}"),
        ({"wanted": ["K"]}, r"wanted is \['K'\]: give \{parameter: standard error\}"),
        ({"wanted": {"Q": 1.0}}, "no free parameter 'Q'"),
        ({"noise": 0.0}, "must be a positive standard deviation"),
        ({"limits": {"y": 0.0}}, "must be a positive number"),
        ({"amplitude": -0.5}, "amplitude, -0.5, must be a positive number"),
        ({"rate": 0.0}, "has no rate: give rate=... in Hz"),
        ({"wanted": {"K": 1e-12}}, "no flight in this band reaches the wanted errors of K ± 1e-12"),
        ({"fixed": {"K": 2.0}}, "no free parameter 'K'"),
    ],
)
def test_bad_requests_are_named(change, sentence):
    settings = {"wanted": {"K": 0.01}, "amplitude": 0.5, "noise": 0.05, **OPEN_LOOP, **change}
    with pytest.raises(ValueError, match=sentence):
        plan_sines(Lag(), LAG, settings.pop("wanted"), **settings)


def test_white_noise_beside_the_response_has_itsnoise_density_at_every_frequency():
    """One-sided, 2 σ² / rate, however long the quiet flight is; what the input makes is no noise."""
    rate, size, omega = 50.0, 0.05, np.linspace(2.0, 100.0, 25)
    for samples in (2000, 4000):
        random = np.random.default_rng(0)
        time = np.arange(samples) / rate
        noise = size * random.normal(size=samples)
        u = np.sin(5 * time)
        response = gb.frequency_response(Lag(), LAG, [5.0]).response[0]
        quiet = gb.Record(time, {"u": u, "y": np.imag(response * np.exp(5j * time)) + noise})
        density = noise_density(quiet, Lag(), LAG, omega, ("u", "y"), rate)
        assert np.mean(density[np.abs(omega - 5) > 1]) == pytest.approx(2 * size**2 / rate, rel=0.1)


def test_sines_that_are_added_stand_in_the_middle_of_the_widest_gap():
    """One sine of sixteen frequencies, at the thirteenth: below it is most room."""
    chosen = with_spare_sines(np.array([12]), 16, 2)
    assert [*chosen] == [5, 12]  # twelve places from 0 to 11


def test_the_plan_is_that_of_the_closed_formulas(lag):
    """In open loop: the Fisher information of sines of amplitude U in white noise, t |U dP/dθ|² rate / (2 σ²)."""
    s = 1j * lag.omega
    slopes = np.array([1 / (0.3 * s + 1), -2.0 * s / (0.3 * s + 1) ** 2])
    weight = lag.duration * lag.amplitude**2 * 50 / (2 * 0.05**2)
    errors = np.sqrt(np.diag(np.linalg.inv(np.real(np.conj(slopes) * weight @ slopes.T))))
    assert [*lag.standard_error.values()] == pytest.approx(errors, rel=1e-4)
    assert [*lag.amplitude] == [0.5] * 3
    assert lag.limited_by == ("u",) * 3

    periods = lag.duration * lag.omega / (2 * np.pi)
    assert periods == pytest.approx(np.round(periods), abs=1e-9)
    assert min(periods) >= 9.99
    settling = (
        np.ceil(2 * lag.omega / (2 * np.pi)) * 2 * np.pi / lag.omega
    )  # whole periods of 2 s at least
    assert lag.flight_time == pytest.approx(
        np.sum(lag.duration + settling) + 4 * 2.0
    )  # and pauses of 2 s around all

    said = str(lag).splitlines()
    assert said[0] == f"3 sines in u, {lag.flight_time:.0f} s of flight"
    first = [
        f"{lag.omega[0]:.4g}",
        f"{lag.omega[0] / 2 / np.pi:.3g}",
        "0.5",
        "u",
        f"{lag.duration[0]:.0f}",
    ]
    assert next(line for line in said if line.split()[:1] == first[:1]).split() == [
        *first,
        f"{periods[0]:.0f}",
    ]


def test_the_smallest_limit_sets_the_amplitude():
    """|P| = 2 / |0.3 s + 1| in open loop: the output below 0.4, and the input below 0.3."""
    limits, wanted = {"y": 0.4, "u": 0.3}, {"K": 0.005, "tau": 0.002}
    found = plan_sines(Lag(), LAG, wanted, amplitude=0.5, noise=0.05, limits=limits, **OPEN_LOOP)
    gain = 2 / np.abs(0.3j * found.omega + 1)
    each = np.array([0.4 / gain, np.full(len(gain), 0.3)])
    assert found.amplitude == pytest.approx(each.min(axis=0), rel=1e-3)
    assert found.limited_by == tuple("yu"[k] for k in each.argmin(axis=0))
    assert {*each.argmin(axis=0)} == {0, 1}


def test_constants_of_a_quiet_flight_are_no_noise():
    random = np.random.default_rng(1)
    time = np.arange(3000) / 50
    u, y = 0.01 * random.normal(size=(2, 3000))
    omega = np.array([0.8, 3.0, 30.0])
    plain = noise_density(gb.Record(time, {"u": u, "y": y}), Lag(), LAG, omega, ("u", "y"), 50.0)
    moved = noise_density(
        gb.Record(time, {"u": u + 7, "y": y - 9}), Lag(), LAG, omega, ("u", "y"), 50.0
    )
    assert moved == pytest.approx(plain, rel=1e-9)


def test_a_quiet_flight_has_a_few_periods_of_the_lowest_frequency():
    time = np.arange(1000) / 50
    record = gb.Record(time, {"u": np.sin(9 * time), "y": np.cos(7 * time)})
    for share, enough in ((0.99, False), (1.01, True)):
        omega = np.array([share * QUIET_PERIODS * 2 * np.pi / 20.0, 30.0])
        if enough:
            assert np.all(np.isfinite(noise_density(record, Lag(), LAG, omega, ("u", "y"), 50.0)))
        else:
            with pytest.raises(
                ValueError, match=r"the quiet flight has 20 s, fewer than \d+ periods of"
            ):
                noise_density(record, Lag(), LAG, omega, ("u", "y"), 50.0)


def test_no_more_sines_are_added_than_there_are_frequencies():
    assert [*with_spare_sines(np.array([1]), 3, 10)] == [0, 1, 2]


def test_a_signal_that_the_model_does_not_have_is_named():
    with pytest.raises(ValueError, match="Lag has no output 'theta'; it has y"):
        plan_sines(Lag(), LAG, {"K": 0.003}, band=(0.5, 15), amplitude=0.5, noise=0.05)


def test_no_sines_are_planned_for_a_loop_that_diverges():
    with pytest.raises(ValueError, match="loop of NonlinearTilt is unstable"):
        plan_sines(
            NonlinearTilt(),
            TILT,
            {"a2": 0.05},
            band=(0.8, 30),
            amplitude=0.03,
            noise=NOISE,
            controller=AttitudeController({"K_theta": -4.0}, rate=RATE),
        )
