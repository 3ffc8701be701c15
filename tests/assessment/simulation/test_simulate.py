"""Simulation and prediction, held against scipy's integrator and against truths that the bands must cover."""

from dataclasses import replace

import numpy as np
import pytest
from declared_models import TILT, TILT_OMEGA, measured
from hardening_spring import Spring, driven, forced
from rate_lag import Lag
from scipy.integrate import solve_ivp
from unfolded import unfolded

import greybox as gb
from greybox.models.controller import AttitudeController
from greybox.models.tilt import NonlinearTilt, Tilt

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {
    "a1": -2.0,
    "a2": 4.0,
    "a3": 3.0,
    "a4": 200.0,
    "C_x": 0.08,
    "T_rotor": 0.048,
    "T_delay": 0.0042,
}


def by_scipy(time, force, start=(0.0, 0.0), **values):
    p = Spring().values(values)
    step = time[1] - time[0]

    def late(t):
        return np.interp(t - p.delay, time, force)

    def derivative(t, x):
        return (x[1], late(t) - p.damping * x[1] - p.stiffness * x[0] - p.hardening * x[0] ** 3)

    return solve_ivp(
        derivative,
        (time[0], time[-1]),
        start,
        t_eval=time,
        rtol=1e-9,
        atol=1e-11,
        max_step=step,
        method="DOP853",
    ).y


def tilt_flight(duration=12.0, seed=1):
    time = np.arange(round(100 * duration)) / 100
    setpoint = 0.1 * sum(np.sin(2 * np.pi * f * time + f) for f in (0.1, 0.35, 0.8, 1.7, 3.1))
    return gb.virtual_flight(
        NonlinearTilt(),
        TRUTH,
        excitation={"reference": setpoint},
        controller=AttitudeController(rate=100),
        noise={"theta": 0.002, "v": 0.05},
        seed=seed,
    )


@pytest.mark.parametrize(
    "values", [{}, {"delay": 0.0513}, {"hardening": 3.0, "damping": 0.2}, {"stiffness": 90.0}]
)
def test_simulation_is_that_of_scipy(values):
    time, force = forced(5.0)
    found = gb.simulate(
        Spring(), values, gb.Record(time, {"force": force}), initial={"position": 0.3}
    )
    exact = by_scipy(time, force, start=(0.3, 0.0), **values)
    # With a delay the interpolated input is exact in its moments over a step, not at every instant.
    tolerance = 2e-4 if "delay" in values else 1e-5
    for k, name in enumerate(("position", "velocity")):
        assert np.abs(found[name] - exact[k]).max() < tolerance * np.ptp(exact[k]), name


def test_a_held_input_is_exact_for_a_plant_that_scipy_holds_too():
    time, force = forced(5.0)
    found = gb.simulate(Spring(), {}, gb.Record(time, {"force": force}), inputs="held")
    x, states = np.zeros(2), []
    for k, t in enumerate(time):
        states.append(x)
        x = solve_ivp(
            lambda _, y, u=force[k]: (y[1], u - 0.8 * y[1] - 4 * y[0]),
            (t, t + 0.02),
            x,
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
    assert np.abs(found["position"] - np.array(states)[:, 0]).max() < 1e-7


def test_a_transfer_function_is_simulated_as_the_ode_that_it_comes_from():
    class Ratio(gb.TransferFunction):
        input, output = "force", "position"
        stiffness, damping = Spring.stiffness, Spring.damping

        def response(self, s, p):
            return 1 / (s**2 + p.damping * s + p.stiffness)

    record = driven()
    ratio, ode = (gb.simulate(m, {}, record)["position"] for m in (Ratio(), Spring()))
    assert np.abs(ratio - ode).max() < 1e-6 * np.ptp(ode)


def test_a_gap_and_a_missing_input_begin_a_new_simulation():
    time, force = forced(10.0)
    kept = (time < 4) | (time > 5)
    force = force.copy()
    force[300:320] = np.nan  # 6 to 6.4 s
    found = gb.simulate(
        Spring(), {}, gb.Record(time[kept], {"force": force[kept]}), initial={"position": [1, 2, 3]}
    )
    assert np.isnan(found["position"]).sum() == 20
    begin = [
        0,
        np.flatnonzero(time[kept] > 5)[0],
        np.flatnonzero(np.isfinite(force[kept]) & (time[kept] >= 6.4))[0],
    ]
    assert found["position"][begin].tolist() == [1, 2, 3]
    alone = gb.simulate(
        Spring(), {}, gb.Record(time[320:], {"force": force[320:]}), initial={"position": 3}
    )
    assert np.allclose(found["position"][begin[2] :], alone["position"], atol=1e-12)


def test_substeps_follow_a_fast_model():
    time, force = forced(4.0)
    values = {"damping": 9.0, "stiffness": 90.0, "hardening": 10.0}
    sparse = gb.Record(time[::5], {"force": force[::5]})
    found = gb.simulate(Spring(), values, sparse, initial={"position": 2.0})
    exact = by_scipy(time[::5], force[::5], start=(2.0, 0.0), **values)
    assert np.abs(found["position"] - exact[0]).max() < 2e-5


def test_errors_of_an_undamped_motion_do_not_add_up():
    time = np.arange(10_000) / 50
    rest = gb.Record(time, {"force": np.zeros(time.size)})
    swing = {"stiffness": 25.0, "damping": 0.0}
    found = gb.simulate(Spring(), swing, rest, initial={"position": 1.0})["position"]
    assert np.abs(found - np.cos(5 * time)).max() < 5e-6  # 8e-4 with 1e-7 in each sample


def test_simulation_of_a_fit_is_its_own_answer():
    record = driven(noise=0.01)
    fit = gb.fit(gb.Problem(Spring(), record, gb.OutputError(biases=("position",))), starts=2)
    found = gb.simulate(fit)
    assert np.nanmax(np.abs(found["position"] - fit.parts[0].simulated["position"])) < 1e-4
    assert "position_error" in found.signals
    assert found.units["position_error"] == "m"


def fitted(seed, duration=8.0):
    record = driven(duration, noise=0.05, seed=seed)
    return record, gb.fit(
        gb.Problem(Spring(), record),
        starts=[{"stiffness": 4.0, "damping": 0.8}],
        progress=False,
        profiles=False,
    )


@pytest.fixture(scope="module")
def repeats():
    return [fitted(seed) for seed in range(10)]


def test_bands_of_simulations_cover_the_truth(repeats):
    inside = []
    for seed, (record, fit) in enumerate(repeats):
        found, exact = gb.simulate(fit), driven(8.0, seed=seed)["position"]
        inside.append(np.abs(found["position"] - exact) <= 1.96 * found["position_error"])
        del record
    assert 0.90 <= np.mean(inside) <= 0.99


def test_bands_of_predictions_cover_the_truth_and_the_measurements(repeats):
    inside, measured = [], []
    for seed, (_, fit) in enumerate(repeats[:8]):
        other = driven(20.0, noise=0.05, seed=100 + seed)
        exact = driven(20.0, seed=100 + seed)["position"]
        found = gb.predict(fit, record=other, horizon=1.0, lead=1.0)
        low, high = found.band("position")
        truth = exact[found.rows]
        inside.append((low <= truth) & (truth <= high))
        low, high = found.band("position", noise=True)
        measured.append((low <= found.measured("position")) & (found.measured("position") <= high))
    assert 0.90 <= np.mean(inside) <= 0.985
    assert 0.92 <= np.mean(measured) <= 0.98


def test_a_longer_lead_in_tells_the_state_better():
    record = driven(40.0, noise=0.05, seed=3)
    exact = driven(40.0, seed=3)["position"]
    short, long = (gb.predict(Spring(), {}, record, horizon=1.0, lead=lead) for lead in (0.1, 1.5))
    error = [np.sqrt(np.mean((p.predicted[0] - exact[p.rows]) ** 2)) for p in (short, long)]
    assert error[1] < 0.5 * error[0]
    # Even a lead-in that shows no velocity leaves the error within what the states do at all.
    assert error[0] < np.std(exact)
    assert np.isclose(np.sqrt(short.noise[0, 0]), 0.05, rtol=0.5)


def test_windows_on_an_unstable_plant_do_not_diverge():
    record = tilt_flight()
    found = gb.predict(NonlinearTilt(), TRUTH, record, horizon=1.0, lead=0.5, inputs="held")
    assert found.rms("theta") < 2.5 * 0.002
    assert found.rms("v") < 1.3 * 0.05
    assert found.rms("theta", 1.0) < 3 * found.rms("theta", 0.05)
    # Before it turns over: beyond, explicit and implicit steps take seconds.
    early = record.between(0.0, 3.0)
    free = gb.simulate(NonlinearTilt(), TRUTH | {"a4": 200.5}, early, inputs="held")
    assert np.abs(free["theta"] - early["theta"]).max() > 10 * found.rms("theta", 1.0)
    # One sample ahead the truth leaves white errors of the size that it says.
    assert 0.95 < np.nanmean(found.one_step**2) < 1.1
    assert abs(np.nanmean(found.one_step[:, :, 1:] * found.one_step[:, :, :-1])) < 0.06


def test_only_the_lead_in_informs_a_prediction():
    record = tilt_flight(4.0)
    usual = gb.predict(NonlinearTilt(), TRUTH, record, horizon=2.9, lead=1.0)
    changed = record["theta"].copy()
    changed[usual.rows[0]] = changed[usual.rows[0][::-1]]  # backward: as large, and wrong
    later = gb.predict(
        NonlinearTilt(), TRUTH, record.with_signals(theta=changed), horizon=2.9, lead=1.0
    )
    assert np.allclose(usual.predicted, later.predicted, atol=1e-6)
    assert later.rms("theta") > 2 * usual.rms("theta")


def test_missing_samples_in_a_lead_in_do_not_matter():
    record = driven(20.0, noise=0.01)
    holes = record["position"].copy()
    holes[::3] = np.nan
    whole, less = (
        gb.predict(Spring(), {}, r, horizon=1.0)
        for r in (record, record.with_signals(position=holes))
    )
    assert less.predicted.shape == whole.predicted.shape
    assert np.abs(less.predicted - whole.predicted).max() < 0.1 * np.std(record["position"])
    assert np.isnan(less.residual("position")).any()


def test_innovations_correct_the_lead_in_alone():
    gusty = gb.virtual_flight(
        NonlinearTilt(),
        TRUTH,
        excitation={"reference": 0.1 * np.sin(np.arange(400) / 40)},
        controller=AttitudeController(rate=100),
        noise={"theta": 0.002, "v": 0.02},
        process_noise={"v": 0.5},
        seed=4,
    )
    gains = {
        f"K_{s}_{o}": v
        for s, o, v in (("v", "v", 0.9), ("theta", "theta", 0.3), ("q", "theta", 2.0))
    }
    corrected = gb.predict(
        NonlinearTilt(), TRUTH | gains, gusty, horizon=0.3, lead=1.0, inputs="held"
    )
    without = gb.predict(NonlinearTilt(), TRUTH, gusty, horizon=0.3, lead=1.0, inputs="held")
    assert corrected.rms("v", 0.04) < 0.7 * without.rms("v", 0.04)
    # Beyond the lead-in it is the same model.
    changed = gusty["v"].copy()
    changed[corrected.rows[-1]] = 99.0
    later = gb.predict(
        NonlinearTilt(), TRUTH | gains, gusty.with_signals(v=changed), horizon=0.3, lead=1.0
    )
    assert np.abs(later.predicted[:, -1]).max() < 10


def test_a_fit_of_a_response_predicts_a_record():
    shared = TILT | {"T_rotor": 0.048, "T_delay": 0.0042}
    fit = gb.fit(gb.Problem(Tilt(), measured(Tilt(), TILT_OMEGA, shared, noise=0.01)), starts=10)
    flight = tilt_flight(6.0)
    found = gb.predict(fit, record=flight, horizon=0.3, lead=0.5)
    assert found.outputs == ("theta",)
    assert found.fit_percent("theta") > 50
    assert np.all(found.error > 0)


class Heated(Spring):
    """A spring with a second sensor, of a gain that nothing else depends on."""

    outputs = ("position", "warmth")
    heating = gb.Parameter(1.0, bounds=(0, 10))

    def output(self, x, u, p):
        return (x.position, p.heating * x.velocity**2)


def test_a_parameter_at_its_bound_counts_as_exact():
    class Narrow(Spring):
        damping = gb.Parameter(0.4, bounds=(0, 0.5), unit="1/s")

    record = driven(8.0, noise=0.05, damping=0.8)
    options = {"starts": [{"stiffness": 4.0}], "progress": False}
    bound = gb.fit(gb.Problem(Narrow(), record), **options)
    fixed = gb.fit(gb.Problem(Spring(), record, fixed={"damping": 0.5}), **options)
    assert np.isnan(bound.standard_error["damping"])
    told, wanted = (gb.simulate(fit)["position_error"] for fit in (bound, fixed))
    assert np.all(wanted > 0)
    assert np.allclose(told, wanted, rtol=0.01)
    told, wanted = (gb.predict(fit, record=record, horizon=1.0).error for fit in (bound, fixed))
    assert np.allclose(told, wanted, rtol=0.01)


def test_what_the_data_do_not_determine_is_told_where_it_matters():
    fit = gb.fit(
        gb.Problem(Heated(), driven(8.0, noise=0.05)), starts=[{}], progress=False, profiles=False
    )
    assert np.isnan(fit.standard_error["heating"])
    found = gb.simulate(fit)
    assert np.all(found["position_error"] > 0)
    assert np.isnan(found["warmth_error"]).mean() > 0.9
    sentence = "the standard errors of Heated are unknown if they depend on heating, which the data of the fit do not"
    assert sentence in found.name
    both = driven(8.0, noise=0.05).with_signals(warmth=found["warmth"])
    predicted = gb.predict(fit, record=both, horizon=1.0)
    assert sentence in unfolded(predicted)
    assert np.isnan(predicted.error[1]).any()
    own = gb.predict(fit, horizon=1.0)
    assert own.notes == ()
    assert np.all(own.error > 0)


def test_answers_print_themselves():
    found = gb.predict(Spring(), {}, driven(noise=0.01), horizon=1.0)
    text = str(found)
    assert "19 windows of 1 s in spring" in text
    assert "position" in text
    assert set(found.record.signals) == {"position", "position_error", "velocity"}


class FastFarFromRest(gb.StateSpace):
    """A state that follows the root of its input, at a rate that grows with it: 8e3 1/s at 2."""

    states = outputs = ("x",)
    inputs = ("u",)
    k = gb.Parameter(2000.0)

    def derivative(self, x, u, p):
        return (p.k * abs(x.x) * (u.u - x.x**2),)

    def output(self, x, u, p):
        return (x.x,)


def test_a_model_that_is_stiff_far_from_rest_follows_its_slow_solution():
    time = np.arange(10) / 10
    drive = gb.Record(time, {"u": 2 + np.sin(time)}, hold={"u": 0.0})
    motion = gb.simulate(FastFarFromRest(), {}, drive, initial={"x": 1.4})
    # It lags by u' / (2 k x²), and explicit steps of 0.4 ms leave it without growing.
    assert motion["x"][1:] == pytest.approx(np.sqrt(drive["u"][1:]), abs=1e-4)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (
            lambda r: gb.simulate(Spring(), {}, r.with_signals(push=r["force"]).rows(np.arange(1))),
            "no two consecutive samples",
        ),
        (lambda r: gb.simulate(Spring(), {"mass": 1.0}, r), "'mass'"),
        (
            lambda r: gb.simulate(Spring(), {}, gb.Record(r.time, {"u": r["force"]})),
            "has no signal 'force', an input of Spring",
        ),
        (lambda r: gb.simulate(Spring(), {}, r, initial={"place": 1.0}), "'place'"),
        (
            lambda r: gb.simulate(Spring(), {}, r, initial={"velocity": np.nan}),
            "the value nan: give a finite",
        ),
        (
            lambda r: gb.simulate(Spring(), {}, r, initial={"velocity": "1 m/s"}),
            "the value '1 m/s': give a finite",
        ),
        (
            lambda r: gb.simulate(Spring(), {}, r, initial={"velocity": [1.0, 2.0]}),
            "has 1 stretch without a gap",
        ),
        (
            lambda r: gb.simulate(Spring(), {"stiffness": [4.0, 5.0]}, r),
            "gives 'stiffness' the value [4.0, 5.0]",
        ),
        (
            lambda r: gb.simulate(
                Spring(), {"stiffness": 4.0, "damping": -90.0}, r.rows(np.arange(200))
            ),
            "diverges at",
        ),
        (
            lambda r: gb.simulate(
                Lag(), {}, gb.Record(r.time, {"u": np.where(np.arange(len(r)) % 2, np.nan, 1.0)})
            ),
            "has no two consecutive samples with all inputs",
        ),
        (
            lambda r: gb.predict(Spring(), {}, r, horizon=0.0),
            "horizon is 0.0: give a length above 0",
        ),
        (
            lambda r: gb.predict(Spring(), {}, r, horizon=True),
            "horizon is True: give a length above 0",
        ),
        (lambda r: gb.predict(Spring(), {}, r, lead="1 s"), "lead is '1 s': give a length above 0"),
        (lambda r: gb.predict(Spring(), {}, r, lead=np.nan), "lead is nan: give a length above 0"),
        (
            lambda r: gb.predict(Spring(), {}, r, horizon=30.0),
            "no room for lead=0.5 and horizon=30 s",
        ),
        (
            lambda r: gb.predict(Spring(), {}, r, horizon=1e300),
            "give a shorter lead or horizon, or a longer record",
        ),
        (
            lambda r: gb.predict(Spring(), {"delay": 0.3}, r, lead=0.2),
            "the delay of Spring is 0.3 s",
        ),
        (
            lambda r: gb.predict(Spring(), {}, gb.Record(r.time, {"force": r["force"]})),
            "none of the outputs",
        ),
        (lambda r: gb.predict(Spring(), {}, r).band("speed"), "'speed' was not predicted"),
        (lambda r: gb.predict(Spring(), {}, r).band("position", level=95), "level 95"),
    ],
)
def test_mistakes_are_told_in_a_sentence(call, sentence):
    with pytest.raises(ValueError, match=r".+\.") as caught:
        call(driven())
    assert sentence in str(caught.value)


def test_things_that_are_not_what_they_should_be():
    with pytest.raises(TypeError, match="give an instance such as"):
        gb.simulate(Spring, {}, driven())
    with pytest.raises(TypeError, match=r"give RungeKutta\(\) or Radau\(\)"):
        gb.simulate(Spring(), {}, driven(), integrator=gb.RungeKutta)
    with pytest.raises(TypeError, match="record is missing"):
        gb.predict(Spring(), {})
    with pytest.raises(TypeError, match="record is missing"):
        gb.simulate(Spring())
    with pytest.raises(TypeError, match="values is <Record"):
        gb.simulate(Spring(), driven())
    declared = gb.simulate(Spring(), None, driven())
    assert declared.is_same_as(gb.simulate(Spring(), {}, driven()))
    with pytest.raises(TypeError, match=r"initial is \[0, 1\]: give \{state: value\}"):
        gb.simulate(Spring(), {}, driven(), initial=[0, 1])
    with pytest.raises(TypeError, match="give one Record; for several, call it for each"):
        gb.predict(Spring(), {}, [driven(), driven()])
    fit = gb.fit(gb.Problem(Spring(), driven(noise=0.01)), starts=1, progress=False, profiles=False)
    with pytest.raises(TypeError, match="or give a record by name, record=r"):
        gb.predict(fit, driven())
    for part in ("0", 1, 0.0, True):
        with pytest.raises(
            ValueError, match=rf"fit with 1 part is {part!r}: give a whole number from -1 to 0"
        ):
            gb.simulate(fit, part=part)


def test_the_record_that_was_fitted_is_known_again_by_its_checksum_and_its_times():
    """It begins where the fit says; another record begins where its own first samples say."""
    record = driven(noise=0.05)
    fit = gb.fit(gb.Problem(Spring(), record), starts=1, progress=False, profiles=False)
    again = replace(record)
    later = replace(record, time=record.time + 1.0)
    found = gb.simulate(fit)["position"]
    assert again is not record
    assert gb.simulate(fit, record=again)["position"] == pytest.approx(found, abs=1e-9)
    assert np.abs(gb.simulate(fit, record=later)["position"] - found)[:20].max() > 1e-6


def test_two_samples_are_enough_and_one_of_a_static_model():
    record = driven(1.0)
    found = gb.simulate(
        Spring(), {}, record.rows(np.arange(2)), initial={"position": 1.0, "velocity": -2.0}
    )
    assert found["position"][1] == pytest.approx(1 - 2 * 0.02, abs=2e-3)
    assert found["velocity"].tolist()[0] == -2.0

    class Gain(gb.StateSpace):
        inputs, outputs = ("force",), ("position",)
        K = gb.Parameter(3.0)

        def output(self, x, u, p):
            return (p.K * u.force,)

    one = record.rows(np.arange(5, 6))
    assert gb.simulate(Gain(), {}, one)["position"] == pytest.approx(3 * one["force"])
    with pytest.raises(ValueError, match="has no sample with all inputs"):
        gb.simulate(Gain(), {}, one.with_signals(force=np.full(1, np.nan)))


@pytest.mark.parametrize(
    ("rate", "delay", "lead", "horizon"),
    [(50.0, 0.31, 0.62, 0.5), (50.0, 0.1, 0.5, 0.5), (16.0, 0.1, 0.625, 0.625)],
)
def test_lengths_are_half_a_second_ten_samples_or_twice_the_delay(rate, delay, lead, horizon):
    time, force = forced(4.0, rate)
    found = gb.predict(
        Spring(), {"delay": delay}, gb.Record(time, {"force": force, "position": force})
    )
    assert (found.lead, found.horizon) == (pytest.approx(lead), pytest.approx(horizon))


def test_a_simulation_is_a_record_of_outputs_and_states_with_the_units_of_the_data():
    record = driven(1.0).with_signals(velocity=np.zeros(50))
    found = gb.simulate(Spring(), {}, record)
    assert list(found.signals) == ["position", "velocity"]
    assert dict(found.units) == {"position": "m"}
    assert found.name == "simulation of Spring"
    assert found.has_time
    np.testing.assert_array_equal(found.time, record.time)
