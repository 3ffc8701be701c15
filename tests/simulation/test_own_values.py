"""What belongs to a record, its biases and trims, is estimated from it where the model was fitted to another one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from drag_flights import Drag, LinearDrag, fitted, flight
from numpy.testing import assert_allclose

import greybox as gb
from greybox.formulation.time_criteria import WIDEST_BIAS
from greybox.simulation import own_values
from greybox.simulation.model_at_estimate import model_at
from greybox.simulation.windows import cut

TRUTH = {"a5": 0.2, "C_x": 0.05}
BIASES = gb.OutputError(biases=("v", "theta"))


def biased(seed, v, theta, **options):
    """A flight whose sensors have constant errors."""
    made = flight(TRUTH, seed, **options)
    signals = {"theta": made["theta"] + theta, "v": made["v"] + v}
    return gb.Record(made.time, signals, made.units, name=f"biased {seed}")


@pytest.fixture(scope="module")
def fit():
    return fitted(Drag(), biased(1, 0.5, 0.01), criterion=BIASES)


def test_biases_are_those_of_the_new_record(fit):
    new = biased(2, -0.8, -0.02)
    found = gb.predict(fit, record=new)
    for name, truth in (("v_bias", -0.8), ("theta_bias", -0.02)):
        value, error = found.own[name]
        assert abs(value - truth) < 4 * error
        assert error < 0.1 * abs(truth)
    (said,) = found.notes
    assert said.startswith("v_bias = -0.")
    assert " m/s and theta_bias = -0.0" in said
    assert "were estimated from biased 2 itself: 2 values from" in said
    assert "not held out" in str(found)
    right = gb.predict(Drag(), {**TRUTH, "v_bias": -0.8, "theta_bias": -0.02}, new)
    kept = gb.predict(fit, record=new, own=())
    assert kept.own == {}
    assert not kept.notes
    assert found.rms("v") < 1.02 * right.rms("v")
    assert kept.rms("v") > 1.5 * right.rms("v")
    assert np.all(found.error > 0)


def test_the_errors_of_own_values_are_those_that_repeated_records_show():
    standardized = []
    for seed in range(30, 35):
        new = biased(seed, 0.3, 0.015, duration=15.0)
        own = gb.predict(Drag(), TRUTH, new, own=["v_bias", "theta_bias"]).own
        standardized += [(own["v_bias"][0] - 0.3) / own["v_bias"][1]]
        standardized += [(own["theta_bias"][0] - 0.015) / own["theta_bias"][1]]
    assert (
        0.5 < np.sqrt(np.mean(np.square(standardized))) < 1.5
    )  # of 10 values, half of them independent


def test_the_record_of_the_fit_keeps_what_was_fitted(fit):
    assert gb.predict(fit).own == {}
    assert gb.predict(fit, record=fit.records[0].data.between(0, 12)).own == {}


class Aircraft(gb.StateSpace):
    """Pitch rate and normal acceleration of an aircraft, with trims that each flight has for itself."""

    states, inputs, outputs = ("alpha", "q"), ("delta",), ("q", "az")
    Z = gb.Parameter(-1.2, bounds=(-5, 0), unit="1/s")
    M_a = gb.Parameter(-4.0, bounds=(-20, 0), unit="1/s²")
    M_q = gb.Parameter(-2.0, bounds=(-10, 0), unit="1/s")
    M_d = gb.Parameter(-8.0, bounds=(-30, 0), unit="1/s²")
    M_0 = gb.Parameter(0.0, bounds=(-5, 5), unit="1/s²")
    az_0 = gb.Parameter(0.0, bounds=(-30, 30), unit="m/s²")

    def derivative(self, x, u, p):
        return (
            p.Z * x.alpha + x.q,
            p.M_a * x.alpha + p.M_q * x.q + p.M_d * u.delta + p.M_0,
        )

    def output(self, x, u, p):
        return (x.q, 60.0 * p.Z * x.alpha + p.az_0)


def flown(seed, M_0, az_0):
    time = np.arange(600) / 25
    random = np.random.default_rng(seed)
    delta = 0.05 * np.sign(np.sin(0.9 * time + random.uniform(0, 6))) + 0.02 * np.sin(3 * time)
    made = gb.simulate(Aircraft(), {"M_0": M_0, "az_0": az_0}, gb.Record(time, {"delta": delta}))
    signals = {"delta": delta, "q": made["q"] + 0.01 * random.normal(size=600)}
    return gb.Record(
        time, {**signals, "az": made["az"] + 0.3 * random.normal(size=600)}, name=f"flight {seed}"
    )


def test_stated_trims_are_estimated_from_the_new_record():
    fit = fitted(Aircraft(), flown(1, 0.1, -9.8))
    new = flown(2, -0.2, -9.0)
    as_it_is = gb.predict(fit, record=new)
    assert as_it_is.own == {}
    trimmed = gb.predict(fit, record=new, own=["M_0", "az_0"])
    for name, truth in (("M_0", -0.2), ("az_0", -9.0)):
        value, error = trimmed.own[name]
        assert abs(value - truth) < 4 * error
        assert error < 0.1
    assert trimmed.fit_percent("az") > as_it_is.fit_percent("az") + 3
    found = gb.compare(
        fit, fitted(Aircraft(), flown(1, 0.1, -9.8), fixed={"M_q": -3.0}), records=new, own="az_0"
    )
    label = found.labels[0]
    assert found.value("values estimated from the records", label, "held-out") == 1
    assert any("az_0 = " in s and "estimated from flight 2 itself" in s for s in found.statements)
    for bad, said in (("az", "no parameter 'az'"), ("x_bias", "no parameter 'x_bias'")):
        with pytest.raises(ValueError, match=said):
            gb.predict(fit, record=new, own=[bad])
    with pytest.raises(ValueError, match="own names 'z', which no fit has"):
        gb.compare(fit, fit, records=new, own=["z"])


def test_parameters_of_every_record_of_a_fit_are_estimated_from_another():
    records = [flown(1, 0.1, -9.8), flown(2, -0.2, -9.0)]
    fit = gb.fit(gb.several(Aircraft(), records, own=["M_0", "az_0"]), starts=1, progress=False)
    found = gb.predict(fit, record=flown(3, 0.3, -10.5))
    assert found.own.keys() == {"M_0", "az_0"}
    assert found.own["az_0"][0] == pytest.approx(-10.5, abs=4 * found.own["az_0"][1])
    # Each record of the fit is predicted with its own.
    assert gb.predict(fit, record=records[1]).own == {}
    assert gb.predict(fit, record=records[1]).rms("az") == pytest.approx(
        gb.predict(fit, part=1).rms("az")
    )
    assert gb.predict(fit, record=records[1]).rms("az") < 0.5


class Integrated(gb.StateSpace):
    """A position from its rate: a constant error of the position cannot be told from where it began."""

    states, inputs, outputs = ("x",), ("rate",), ("x",)
    gain = gb.Parameter(1.0, bounds=(0, 5))

    def derivative(self, x, u, p):
        return (p.gain * u.rate,)

    def output(self, x, u, p):
        return (x.x,)


def test_what_the_record_does_not_determine_is_said_and_kept():
    time = np.arange(400) / 20
    random = np.random.default_rng(0)
    rate = np.sin(0.8 * time)
    x = gb.simulate(Integrated(), {"gain": 2.0}, gb.Record(time, {"rate": rate - 0.1}))["x"]
    record = gb.Record(time, {"rate": rate, "x": x + 0.05 * random.normal(size=400)}, name="ramp")
    found = gb.predict(Integrated(), {"gain": 2.0}, record, own=["x_bias", "rate_bias"])
    assert found.own.keys() == {"rate_bias"}
    assert found.own["rate_bias"][0] == pytest.approx(0.1, abs=0.01)
    assert "x_bias: not determined by ramp, the value of the fit is kept." in found.notes
    alone = gb.predict(Integrated(), {"gain": 2.0}, record, own=["x_bias"])
    assert alone.own == {}
    assert "x_bias: not determined by ramp, the value of the fit is kept." in alone.notes
    assert alone.rms("x") == pytest.approx(
        gb.predict(Integrated(), {"gain": 2.0}, record, own=()).rms("x")
    )


def test_models_with_their_own_biases_are_compared_and_counted(fit):
    linear = fitted(LinearDrag(), fit.records[0].data, criterion=BIASES)
    new = biased(2, -0.8, -0.02)
    found = gb.compare(fit, linear, records=new)
    assert found.value("values estimated from the records", "Drag", "held-out") == 2
    assert [
        s.split(":")[0] for s in found.statements if "estimated from biased 2 itself" in s
    ] == list(found.labels)
    assert "Drag predicts held-out data better than LinearDrag" in str(found)
    kept = gb.compare(fit, linear, records=new, own=())
    assert found.value("error (rms)", "Drag", "held-out", "v") < 0.7 * kept.value(
        "error (rms)", "Drag", "held-out", "v"
    )
    with pytest.raises(ValueError, match="there is no 'values estimated from the records'"):
        kept.value("values estimated from the records", "Drag", "held-out")


class Gain(gb.StateSpace):
    """An output that follows its input at once."""

    states, inputs, outputs = (), ("u",), ("y",)
    K = gb.Parameter(2.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.K * u.u,)


@pytest.mark.parametrize("every", [1, 2])
def test_the_error_of_a_constant_offset_is_that_of_a_mean(every):
    """White errors of 0.1, and every so many samples measured: 0.1 over the root of their number."""
    time = np.arange(400) / 20
    u = np.sin(time)
    y = 2 * u + 0.7 + 0.1 * np.random.default_rng(0).normal(size=400)
    y[np.arange(400) % every != 0] = np.nan
    found = gb.predict(Gain(), {"K": 2.0}, gb.Record(time, {"u": u, "y": y}), own=["y_bias"])
    value, error = found.own["y_bias"]
    assert value == pytest.approx(np.nanmean(y - 2 * u), abs=0.3 * error)
    assert error == pytest.approx(0.1 / np.sqrt(400 / every), rel=0.12)


def informed(matrix, squares=100.0, numbers=100, overlap=1.0):
    matrix = np.array(matrix)
    return own_values._Information(matrix, np.zeros(len(matrix)), squares, numbers, overlap)


@pytest.mark.parametrize(
    ("matrix", "limits", "lost"),
    [
        (np.diag([4.0, 100.0]), (10.0, 10.0), ""),
        (np.diag([4.0, 100.0]), (0.4, 10.0), "a"),  # its error of 0.5 is more than half of ± 0.4
        (np.diag([4.0, 100.0]), (0.6, 0.09), "b"),
        (np.diag([4.0, 0.0]), (np.inf, np.inf), "b"),  # no sample changes with it
        ([[1.0, 1.0 - 1e-11], [1.0 - 1e-11, 1.0]], (np.inf, np.inf), "a"),
        ([[1.0, 1.0 - 1e-7], [1.0 - 1e-7, 1.0]], (np.inf, np.inf), ""),
    ],
)
def test_a_value_is_lost_where_no_sample_shows_it_or_its_error_exceeds_half_of_its_bounds(
    matrix, limits, lost
):
    of = {name: (-limit, limit) for name, limit in zip("ab", limits, strict=True)}
    found = own_values._not_determined(informed(matrix), ("a", "b"), of)
    assert bool(found) == bool(lost)
    if np.isfinite(limits).all() or np.count_nonzero(matrix) < 4:
        assert found == lost


def test_directions_that_are_not_seen_have_no_inverse():
    random = np.random.default_rng(0)
    size = np.array([1e3, 1.0, 1e-4])
    J = random.normal(size=(6, 3)) * size
    assert_allclose(own_values._pseudo_inverse(J.T @ J), np.linalg.inv(J.T @ J), rtol=1e-9)
    J[:, 1] = 0
    found = own_values._pseudo_inverse(J.T @ J)
    assert np.all(found[1] == 0)
    seen = np.ix_([0, 2], [0, 2])
    assert_allclose(found[seen], np.linalg.inv((J.T @ J)[seen]), rtol=1e-9)


def test_errors_are_larger_by_what_is_left_over_and_by_numbers_that_were_used_twice():
    for squares, numbers, overlap, factor in (
        (50.0, 100, 1.0, 1.0),
        (200.0, 100, 1.0, 2.0),
        (200.0, 100, 1.5, 3.0),
    ):
        assert own_values._inflation(
            informed(np.eye(1), squares, numbers, overlap)
        ) == pytest.approx(factor)
        found = own_values._Found(None, None, ("a",), informed([[4.0]], squares, numbers, overlap))
        assert found.errors() == pytest.approx([np.sqrt(factor) / 2])


@pytest.mark.parametrize(
    ("squares", "before", "follows"),
    [
        (119.0, 100.0, True),
        (121.0, 100.0, False),
        (119.0, 50.0, True),
        (121.0, 50.0, False),
        (235.0, 200.0, True),
    ],
)
def test_longer_windows_count_while_their_errors_grow_by_a_tenth_at_most(squares, before, follows):
    """A fifth in squares, over those of shorter ones or over the noise."""
    longer, shorter = (
        own_values._Found(None, None, ("a",), informed([[4.0]], s)) for s in (squares, before)
    )
    assert longer.follows_noise_as(shorter) is follows
    nothing = own_values._Found(None, None, (), None)
    assert longer.follows_noise_as(nothing)
    assert not nothing.follows_noise_as(shorter)


def test_what_determines_more_values_or_the_same_better_is_taken():
    def found(*diagonal):
        return own_values._Found(
            None, None, tuple("abc"[: len(diagonal)]), informed(np.diag(diagonal))
        )

    assert found(1.0, 1.0).is_more_certain_than(found(100.0))
    assert not found(100.0).is_more_certain_than(found(1.0, 1.0))
    assert found(1.0, 5.0).is_more_certain_than(found(2.0, 2.0))
    assert not found(1.0, 3.0).is_more_certain_than(found(2.0, 2.0))


def test_a_bias_lies_within_ranges_of_its_signal_and_a_parameter_within_its_bounds():
    signals = {"y": np.array([1.0, np.nan, 4.0]), "still": np.ones(3), "lost": np.full(3, np.nan)}
    windows = SimpleNamespace(record=gb.Record(np.arange(3.0), signals, {"y": "m"}))
    model = SimpleNamespace(declared={"K": gb.Parameter(1.0, bounds=(-1, 5), unit="1/s")})
    for name, limits, unit in (
        ("K", (-1, 5), "1/s"),
        ("y_bias", (-3 * WIDEST_BIAS, 3 * WIDEST_BIAS), "m"),
        ("still_bias", (-WIDEST_BIAS, WIDEST_BIAS), ""),
        ("lost_bias", (-np.inf, np.inf), ""),
        ("other_bias", (-np.inf, np.inf), ""),
    ):
        assert own_values._limits(model, windows, name) == limits
        assert own_values._unit(model, windows, name) == unit


def test_the_error_of_the_model_is_in_that_of_an_own_value_that_follows_it():
    """A mean of y - K u, with a gain that is known to 0.1 alone."""

    class Known:
        def at_estimate(self, model, **options):
            return replace(model_at(Gain(), {"K": 2.0}), covariance=np.array([[0.01]]))

    time = np.arange(400) / 20
    u = 1 + np.sin(time)
    y = 2 * u + 0.7 + 0.1 * np.random.default_rng(0).normal(size=400)
    record = gb.Record(time, {"u": u, "y": y})
    alone = gb.predict(Gain(), {"K": 2.0}, record, own=["y_bias"])
    found = gb.predict(Known(), record=record, own=["y_bias"])
    assert found.own["y_bias"][0] == pytest.approx(alone.own["y_bias"][0])
    error = np.sqrt(alone.own["y_bias"][1] ** 2 + 0.01 * u.mean() ** 2)
    assert found.own["y_bias"][1] == pytest.approx(error, rel=0.02)
    # The output is known where the input has its mean: there the errors of both cancel.
    size = np.sqrt(alone.own["y_bias"][1] ** 2 + 0.01 * (u - u.mean()) ** 2)
    assert_allclose(found.error[0, :, 0], size[found.rows[:, 0]], atol=2e-3)


def test_states_and_their_mean_are_eliminated_as_by_least_squares():
    """Of windows with random slopes and a prior, against one matrix of all unknowns."""
    random = np.random.default_rng(0)
    w, t, k, n, a = 4, 5, 2, 2, 3
    slopes, residuals = random.normal(size=(w, t, k, n + a)), random.normal(size=(w, t, k))
    used = random.uniform(size=(w, t, k)) < 0.9
    slopes[~used], residuals[~used] = 0.0, 0.0
    used[3], slopes[3], residuals[3] = False, 0.0, 0.0  # a window without a measured sample
    states, mean, precision = (
        random.normal(size=(w, n)),
        random.normal(size=n),
        np.array([0.5, 2.0]),
    )
    noise = np.array([[0.5, 0.2], [0.2, 0.4]])
    initial = SimpleNamespace(states=states, mean=mean, precision=precision, noise=noise)
    made = SimpleNamespace(slopes=slopes, residuals=residuals, used=used, initial=initial)
    simulator = SimpleNamespace(linearize_windows=lambda windows, places: made)
    found = own_values._information(simulator, SimpleNamespace(horizon=6, lead=3), np.arange(a))

    weight = np.linalg.inv(np.linalg.cholesky(noise))
    J = np.einsum("ij,wtjv->wtiv", weight, slopes).reshape(w, t * k, n + a)
    r = np.einsum("ij,wtj->wti", weight, residuals).reshape(w, t * k)
    deviation = states - mean
    deviation[3] = 0.0
    of_values = np.concatenate([*J[:, :, n:], np.zeros((w * n, a))])
    of_mean = np.concatenate([*J[:, :, :n], np.zeros((w * n, n))])
    of_windows = np.zeros((w * t * k + w * n, w * n))
    for i in range(w):
        of_windows[i * t * k : (i + 1) * t * k, i * n : (i + 1) * n] = J[i, :, :n]
        of_windows[w * t * k + i * n + np.arange(n), i * n + np.arange(n)] = np.sqrt(precision)
    b = np.concatenate([r.ravel(), *(-np.sqrt(precision) * deviation)])
    nuisances = np.hstack([of_mean, of_windows])
    q = np.eye(len(b)) - nuisances @ np.linalg.pinv(nuisances)
    assert_allclose(found.matrix, of_values.T @ q @ of_values, atol=1e-9)
    assert_allclose(found.gradient, of_values.T @ q @ b, atol=1e-9)
    assert found.squares == pytest.approx(b @ q @ b)
    assert (found.numbers, found.overlap) == (used.sum(), 1.5)


# --- steps to the best values, and windows that become longer


def parabola(q):
    """Squares (q - 3)² of four numbers; beyond 10 fewer of them are finite."""
    numbers = 4 if q[1] < 10 else 3
    return own_values._Information(np.eye(1), np.zeros(1), float((q[1] - 3) ** 2), numbers, 1.0)


@pytest.mark.parametrize(
    ("step", "limits", "taken"),
    [
        (2.0, (-50, 50), 2.0),
        (4.1, (-50, 50), 2.05),  # would end farther off than it began
        (3.9, (-50, 50), 3.9),
        (4.0, (-50, 50), 4.0),  # no worse
        (36.0, (-50, 50), 2.25),
        (9.5, (-50, 50), 2.375),  # to where fewer numbers are finite
        (-1.0, (-50, 50), 0.0),
        (8.0, (-50, 2.5), 1.5),
        (500.0, (-50, 50), 3.90625),
        (550.0, (-50, 50), 0.0),  # not within eight of them
    ],
)
def test_a_step_of_the_values_is_halved_until_it_predicts_no_worse(step, limits, taken):
    q = np.array([7.0, 1.0])
    low, high = (np.array([limit]) for limit in limits)
    moved, after, change = own_values._searched(
        parabola, q, parabola(q), np.array([1]), np.array([step]), (low, high)
    )
    assert_allclose(change, [taken])
    assert_allclose(moved, [7.0, 1.0 + taken])
    assert after.squares == pytest.approx((1.0 + taken - 3) ** 2)


def linear_windows(measured, slopes):
    """A stand-in for windows without states, whose outputs are slopes · q[1:] of three values."""

    def at(q):
        residuals = measured - slopes @ q[1:]
        noise = np.array([[0.25]])
        initial = SimpleNamespace(
            states=np.zeros((len(measured), 0)),
            mean=np.zeros(0),
            precision=np.zeros(0),
            noise=noise,
        )
        made = SimpleNamespace(
            slopes=slopes, residuals=residuals, used=np.isfinite(residuals), initial=initial
        )
        return SimpleNamespace(linearize_windows=lambda windows, places: made)

    return SimpleNamespace(at=at)


@pytest.mark.parametrize("bound", [np.inf, 1.2])
def test_the_best_values_are_those_of_least_squares_within_their_limits(bound):
    random = np.random.default_rng(5)
    slopes = random.normal(size=(6, 4, 1, 2))
    measured = slopes @ [2.0, -0.5] + 0.1 * random.normal(size=(6, 4, 1))
    wanted = np.linalg.lstsq(slopes.reshape(-1, 2), measured.ravel(), rcond=None)[0]
    model = replace(model_at(Gain(), {"K": 7.0}), q=np.array([7.0, 20.0, 0.0]))
    limits = [(-bound, bound), (-10.0, 10.0)]
    simulator, windows = linear_windows(measured, slopes), SimpleNamespace(horizon=6, lead=2)
    solved, found = own_values._minimized(simulator, model, windows, np.array([1, 2]), limits)
    assert found.numbers == 24
    assert found.overlap == pytest.approx(8 / 6)
    assert solved.q[0] == 7.0
    if np.isinf(bound):
        assert_allclose(solved.q[1:], wanted)
        rest = measured.ravel() - slopes.reshape(-1, 2) @ wanted
        assert found.squares == pytest.approx(4 * rest @ rest)
        assert_allclose(found.matrix, 4 * slopes.reshape(-1, 2).T @ slopes.reshape(-1, 2))
    else:
        assert solved.q[1] == 1.2
    unseen = linear_windows(np.full((6, 4, 1), np.nan), slopes)
    assert own_values._minimized(unseen, model, windows, np.array([1, 2]), limits) is None


def test_windows_become_four_times_as_long_up_to_the_longest_stretch():
    time = 0.1 * np.arange(130)
    time[30:] += 5
    record = gb.Record(time, {"u": np.sin(time), "y": np.cos(time)})
    model = model_at(Gain(), {})
    windows = cut(record, ["u"], ["y"], lead=0.5, horizon=0.4)
    assert (windows.lead, windows.horizon) == (5, 4)
    found = list(own_values._longer(model, windows, ("y",)))
    assert [(w.lead, w.horizon, len(w)) for w in found] == [(5, 16, 6), (5, 64, 1), (5, 95, 1)]
    assert list(own_values._longer(model, found[-1], ("y",))) == []
    rows = cut(
        gb.Record(np.arange(4.0), {"u": np.ones(4), "y": np.ones(4)}, has_time=False),
        ["u"],
        ["y"],
        lead=1,
        horizon=1,
    )
    assert list(own_values._longer(model, rows, ("y",))) == []


def test_own_values_are_told_with_errors_and_units():
    of = own_values.OwnValues
    found = of(("a", "b"), np.array([0.5, -2.0]), np.array([0.1, 0.25]), ("m", "1"), ("c", "d"), 1)
    assert found.by_name == {"a": (0.5, 0.1), "b": (-2.0, 0.25)}
    first, second = found.notes("r")
    assert first == (
        "a = 0.50 ± 0.10 m and b = -2.00 ± 0.25 were estimated from r itself: 2 values from 1 number, in which it is "
        "not held out."
    )
    assert second == "c and d: not determined by r, the value of the fit is kept."
    alone = of(("a",), np.array([0.5]), np.array([0.1]), ("m",), (), 40)
    (said,) = alone.notes("r")
    assert "m was estimated from r itself: 1 value from 40 numbers, in which" in said
