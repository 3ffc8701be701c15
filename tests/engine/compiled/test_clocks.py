"""Fits of records on many clocks, against closed forms and least squares by SciPy."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from unfolded import unfolded

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Lag(gb.StateSpace):
    """tau y' = K u - y."""

    states = outputs = ("y",)
    inputs = ("u",)
    tau = gb.Parameter(0.1, bounds=(0.001, 10), unit="s")
    K = gb.Parameter(1.0, bounds=(-1000, 1000))

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.y) / p.tau,)

    def output(self, x, u, p):
        return (x.y,)


class LateLag(Lag):
    """The lag behind a delay."""

    delays = {"u": "T"}
    T = gb.Parameter(0.02, bounds=(0, 0.05), unit="s")


class Decay(gb.StateSpace):
    """y' = -k y."""

    states = outputs = ("y",)
    inputs = ()
    k = gb.Parameter(0.5, bounds=(0.001, 5), unit="1/s")

    def derivative(self, x, u, p):
        return (-p.k * x.y,)

    def output(self, x, u, p):
        return (x.y,)


class Demand(gb.StateSpace):
    """y' = k (a - y)."""

    states = outputs = ("y",)
    inputs = ()
    a = gb.Parameter(15.0, bounds=(1, 100), unit="mg/l")
    k = gb.Parameter(0.3, bounds=(0.01, 10), unit="1/d")

    def derivative(self, x, u, p):
        return (p.k * (p.a - x.y),)

    def output(self, x, u, p):
        return (x.y,)


def lag(time, u, tau, K=1.0, first=0.0):
    """The lag driven by values that are held until the next sample."""
    y = np.full(len(time), float(first))
    for k in range(len(time) - 1):
        y[k + 1] = K * u[k] + (y[k] - K * u[k]) * np.exp(-(time[k + 1] - time[k]) / tau)
    return y


def commands(count, block=15, seed=0):
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], count // block + 1), block)[
        :count
    ]


def noise(count, size=0.01, seed=1):
    return size * np.random.default_rng(seed).standard_normal(count)


def record(time, u, y, rows=slice(None), **options):
    hold = {"u": np.inf, "y": 0.0}
    return gb.Record(time[rows], {"u": u[rows], "y": y[rows]}, hold=hold, **options)


def fit(data, model=None, **options):
    return gb.fit(gb.Problem(model or Lag(), data, **options), 1, progress=False)


def deviation(answer, name, truth):
    """In standard errors."""
    return abs(answer.estimate[name] - truth) / answer.standard_error[name]


def in_stamps(rate, quantum, count=1500):
    """A fit from stamps of a uniform clock, and the same from its own times."""
    tau, time, u = 20.8 / rate, np.arange(count) / rate, commands(count)
    y = lag(time, u, tau) + noise(count)
    answer = fit(record(np.round(time / quantum) * quantum, u, y))
    (part,) = answer.records
    assert part.initial["y"].size == 1
    assert (part.compared, part.unused) == (count, 0)
    assert deviation(answer, "tau", tau) < 5
    return answer, fit(record(time, u, y))


@pytest.mark.parametrize(
    ("rate", "quantum"),
    [(75, 0.01), (90, 0.01), (714, 1e-3), (833, 1e-3), (607, 1e-3), (62, 1 / 64)],
)
def test_coarse_stamps_of_a_uniform_clock_cost_nothing(rate, quantum):
    """A wrong time of half a quantum is noise; a new stretch behind it was a bias of 25 %."""
    answer, exact = in_stamps(rate, quantum)
    assert f"stamps of {1e3 * quantum:.4g} ms that round a clock of" in str(answer)
    assert answer.standard_error["tau"] < 1.2 * exact.standard_error["tau"]
    assert abs(answer.estimate["tau"] - exact.estimate["tau"]) < exact.standard_error["tau"]


@pytest.mark.parametrize(("rate", "quantum"), [(38.4, 1 / 64), (29, 1 / 64), (400, 1e-3)])
def test_stamps_of_two_neighboring_multiples_of_any_unit_cost_nothing(rate, quantum):
    """Where all stamps are within a quarter of a step, too, and a unit is 1/64 s."""
    answer, exact = in_stamps(rate, quantum)
    for both in (answer.estimate, exact.estimate), (answer.standard_error, exact.standard_error):
        assert both[0]["tau"] == pytest.approx(both[1]["tau"], rel=1e-3)


def test_few_stamps_beside_the_usual_step_cost_nothing():
    """Six steps of two ticks in 148 of one were six holes, with a new stretch behind each."""
    answer, exact = in_stamps(100 / 1.044, 0.01, 148)
    assert answer.standard_error["tau"] < 1.2 * exact.standard_error["tau"]


random = np.random.default_rng(5)
UNEVEN = {
    "100 to 50 Hz": np.r_[np.arange(300) / 100, 3 + np.arange(150) / 50],
    "100 to 40 Hz": np.r_[np.arange(300) / 100, 3 + np.arange(120) / 40],
    "jitter": np.arange(400) / 100 + random.uniform(-3e-3, 3e-3, 400),
    "small jitter": np.arange(400) / 100 + random.uniform(-1e-3, 1e-3, 400),
    "random": np.cumsum(random.exponential(0.01, 400)),
    "schedule": np.r_[0, np.cumsum(random.choice([1, 1, 2, 2, 2, 4], 300))] / 100,
    "lab": np.array([0, 15, 30, 45, 60, 90, 120, 180]) / 100,
    "a lab in two rates": np.r_[np.arange(10), 10, 20, 30, 40, 50, 60] / 50,
}


@pytest.mark.parametrize("clock", UNEVEN)
def test_a_model_runs_on_through_uneven_steps(clock):
    """The same minimum and errors as by SciPy, from the times as they are."""
    time = UNEVEN[clock]
    u = commands(time.size, block=15 if time.size > 20 else 2)
    y = lag(time, u, 0.2, 2.0, 0.3) + noise(time.size, 0.02)
    answer = fit(record(time, u, y), criterion=gb.OutputError(noise={"y": 0.02}))
    best = least_squares(
        lambda v: (lag(time, u, *v) - y) / 0.02, [0.2, 2.0, 0.3], x_scale=[0.1, 1, 1], xtol=1e-12
    )
    error = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
    assert answer.records[0].initial["y"].size == 1
    found = [answer.estimate["tau"], answer.estimate["K"], answer.records[0].initial["y"][0]]
    assert_allclose((np.array(found) - best.x) / error, 0, atol=0.01)


@pytest.mark.parametrize("clock", ["100 to 50 Hz", "schedule"])
def test_a_delay_is_found_where_steps_are_whole_multiples_of_one(clock):
    time = UNEVEN[clock]
    step = np.diff(time).min()
    grid = np.arange(0, time[-1] + step / 2, step)
    rows = np.searchsorted(grid, time - step / 2)
    u = commands(grid.size)
    u = u[rows][np.searchsorted(time, grid + step / 2) - 1]  # held from row to row
    late = np.r_[np.full(3, u[0]), u[:-3]]
    late[:3] = u[0]
    y = lag(grid, late, 0.2, 2.0) + noise(grid.size, 1e-4)
    answer = fit(record(time, u[rows], y[rows]), LateLag(), fixed={"tau": 0.2, "K": 2.0})
    assert answer.estimate["T"] == pytest.approx(3 * step, abs=0.05 * step)


def test_lost_rows_cost_precision_in_proportion():
    """Between rows of one value the input is known; where it changes, a stretch begins anew."""
    time, u = np.arange(2000) / 100, commands(2000)
    y = lag(time, u, 0.2778) + noise(2000)
    whole = fit(record(time, u, y)).standard_error["tau"]
    rows = np.arange(2000)
    tenth = rows % 10 != 9
    for seed, kept in enumerate((0.99, 0.9, 0.7)):
        random = np.random.default_rng(seed).random(2000) < kept
        for there in (random, tenth) if kept == 0.9 else (random,):
            answer = fit(record(time, u, y, there))
            assert deviation(answer, "tau", 0.2778) < 4
            assert answer.standard_error["tau"] < 2.5 * whole / np.sqrt(kept)
            assert answer.records[0].unused < 0.02 * there.sum()


def test_a_smooth_input_runs_on_across_single_rows_and_a_wild_one_does_not():
    time = np.arange(2000) / 100
    smooth = np.sin(3 * time) + np.sin(8 * time + 1) + np.sin(time)
    wild = np.random.default_rng(8).uniform(-1, 1, 2000)
    there = np.random.default_rng(9).random(2000) < 0.9
    for u, most in ((smooth, 60), (wild, 1000)):
        y = lag(time, u, 0.2778) + noise(2000)
        whole, lost = (fit(record(time, u, y, rows)) for rows in (slice(None), there))
        stretches = lost.records[0].initial["y"].size
        assert stretches < most
        for name, truth in (("tau", 0.2778), ("K", 1.0)):
            assert deviation(lost, name, truth) < 4
            limit = 1.5 if u is smooth else 6
            assert lost.standard_error[name] < limit * whole.standard_error[name]
    assert stretches > 100


def test_a_hole_in_a_moving_input_is_lost_rows_and_what_is_stated_is_done():
    """Held across 0.6 s, the old value of the input would make another plant."""
    time, u = np.arange(6000) / 100, commands(6000, 20)
    y = lag(time, u, 5.0, 150.0) + noise(6000, 0.3)  # nearly an integrator, gain 30 1/s
    there = (time < 30) | (time >= 30.6)
    answers = {gaps: fit(record(time, u, y, there, gaps=gaps)) for gaps in ("auto", "bridge")}
    cut = answers["auto"]
    assert deviation(cut, "K", 150) < 4
    assert deviation(cut, "tau", 5) < 4
    assert cut.records[0].initial["y"].size == 2
    assert "inputs are unknown at 1, where a new stretch begins" in unfolded(cut)
    assert json.loads(cut.to_json())["gaps"] == [
        {"part": "Lag", "text": cut.records[0].gaps, "stretches": 2, "unused": 0}
    ]
    assert answers["bridge"].records[0].initial["y"].size == 1
    assert "inputs are known there, as stated" in unfolded(answers["bridge"])


def test_without_a_moving_input_a_hole_is_none():
    """One initial state for all: the decay behind the hole shows the rate best."""
    time = np.r_[np.arange(0, 1, 0.01), np.arange(5, 6, 0.01)]
    y = np.exp(-0.3 * time) + noise(200)
    step = gb.Record(time, {"u": np.ones(200), "y": 1 - y})
    without = gb.Record(time, {"y": y})
    answer = fit(without, Decay())
    assert deviation(answer, "k", 0.3) < 4
    assert answer.records[0].initial["y"].size == 1
    assert "where the model runs on" in unfolded(answer)
    assert fit(step).records[0].initial["y"].size == 1
    cut = fit(gb.Record(time, {"y": y}, gaps="cut"), Decay())
    assert cut.records[0].initial["y"].size == 2
    assert cut.standard_error["k"] > 3 * answer.standard_error["k"]


def test_the_initial_state_is_known_at_the_first_sample_alone():
    time = np.array([0.0, 15, 30, 45, 60, 90, 120, 180])
    y = np.exp(-0.02 * time) + noise(8)
    answer = fit(gb.Record(time, {"y": y}), Decay(), criterion=gb.OutputError(initial={"y": 1.0}))
    best = least_squares(lambda k: np.exp(-k * time) - y, 0.02, xtol=1e-12)
    assert answer.estimate["k"] == pytest.approx(best.x[0], rel=1e-6)
    assert answer.records[0].compared == 8
    assert answer.records[0].initial["y"].tolist() == [1.0]


def test_biochemical_oxygen_demand_on_days_1_to_5_and_7():
    """Bates and Watts (1988), Nonlinear Regression Analysis, appendix A1.4: a 19.143, k 0.5311."""
    time = np.array([0.0, 1, 2, 3, 4, 5, 7])
    y = np.array([np.nan, 8.3, 10.3, 19.0, 16.0, 15.6, 19.8])
    known = gb.OutputError(initial={"y": 0.0})
    answer = fit(gb.Record(time, {"y": y}), Demand(), criterion=known)
    assert answer.estimate["a"] == pytest.approx(19.143, abs=6e-4)
    assert answer.estimate["k"] == pytest.approx(0.5311, abs=6e-5)


@pytest.mark.parametrize("given", [{"y": 0.01}, "diagonal"])
def test_batches_with_one_measured_point_each_are_a_fit(given):
    """Destructive sampling: the initial state is known, and only the last sample is measured."""
    time = np.arange(1.0, 7.0)
    y = np.exp(-0.3 * time) + noise(6)
    batches = [
        gb.Record([0.0, t], {"y": [np.nan, value]}, name=f"batch {t:g}")
        for t, value in zip(time, y, strict=True)
    ]
    criterion = gb.OutputError(initial={"y": 1.0}, noise=given)
    answer = gb.fit(gb.several(Decay(), batches, criterion=criterion), 1, progress=False)
    best = least_squares(lambda k: np.exp(-k * time) - y, 0.3, xtol=1e-12)
    size = 0.01 if given != "diagonal" else np.sqrt(2 * best.cost / 5)
    assert answer.estimate["k"] == pytest.approx(best.x[0], rel=1e-4)
    assert answer.standard_error["k"] == pytest.approx(size / np.linalg.norm(best.jac), rel=0.3)
    unknown = gb.OutputError(noise=given)
    with pytest.raises(ValueError, match=r"no usable stretch.* known initial states"):
        gb.fit(gb.several(Decay(), batches, criterion=unknown), 1, progress=False)


def test_samples_that_say_nothing_are_counted():
    """A lonely sample of a moving input behind lost rows: its initial state explains it."""
    u = np.random.default_rng(2).uniform(-1, 1, 300)
    time = np.arange(300) / 100
    y = lag(time, u, 0.2) + noise(300)
    there = np.ones(300, dtype=bool)
    there[[100, 102, 200]] = False
    answer = fit(record(time, u, y, there))
    (part,) = answer.records
    assert (part.initial["y"].size, part.compared, part.unused) == (3, 296, 1)
    assert "1 sample not used" in part.gaps
    # The simulation of the fit has the same stretches.
    motion = gb.simulate(answer)
    assert_allclose(motion["y"], part.simulated["y"], atol=1e-6)


def test_an_output_at_another_rate_and_missing_values_in_a_schedule():
    time = np.r_[np.arange(0, 2, 0.01), np.arange(2, 6, 0.05)]
    u = commands(time.size)
    y = lag(time, u, 0.2) + noise(time.size)
    y[np.arange(time.size) % 5 != 0] = np.nan
    answer = fit(record(time, u, y))
    assert deviation(answer, "tau", 0.2) < 4
    assert answer.records[0].compared == np.isfinite(y).sum()


def test_gaps_are_stored_with_a_fit(tmp_path):
    time, u = np.arange(400) / 100, commands(400)
    y = lag(time, u, 0.2) + noise(400)
    there = (time < 2) | (time > 2.5)
    for gaps in ("auto", "bridge", "cut"):
        answer = fit(record(time, u, y, there, gaps=gaps))
        gb.save(answer, tmp_path / f"{gaps}.h5")
        again = gb.load(tmp_path / f"{gaps}.h5", models=[Lag])
        assert again.records[0].data.gaps == gaps
        assert again.records[0].gaps == answer.records[0].gaps != ""


def test_gains_need_even_steps():
    time = UNEVEN["100 to 40 Hz"]
    u = commands(time.size)
    data = record(time, u, lag(time, u, 0.2) + noise(time.size))
    with pytest.raises(ValueError, match="constant gain, and its record is not uniformly sampled"):
        fit(data, criterion=gb.PredictionError())
