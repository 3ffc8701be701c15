"""Records as the estimators see them: delayed inputs held against integrals, gaps, missing
samples, and bad input.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

import greybox as gb
from greybox.engine.compiled.sampled_data import (
    SampledData,
    Stretch,
    gapless,
    input_over_step,
    joined,
    sampled_data,
)

STEP = 0.02
RANDOM = np.random.default_rng(0)


def record(n=60, outputs=("y",), step=STEP, start=3.0, **signals):
    time = start + step * np.arange(n)
    given = (
        {"u": np.random.default_rng(1).normal(size=n)}
        | {k: np.arange(n) + 100.0 for k in outputs}
        | signals
    )
    return gb.Record(time, given, name="made")


def cut(data, *, inputs=("u",), outputs=("y",), lead=0.0, segment_length=7, complete=False):
    made = sampled_data(data, inputs, outputs, lead=lead, complete=complete)
    return replace(made, segment_length=segment_length)


def measured_input(u, held):
    """The measured input as a function of time, in steps: constant before its first and after
    its last sample.
    """
    if held:
        return lambda t: u[int(np.clip(np.floor(t + 1e-12), 0, u.size - 1))]
    return lambda t: np.interp(t, np.arange(u.size), u)


DELAYS = [0.0, 0.25, 0.999999, 1.0, 1.5, 3.0, 4.75]


@pytest.mark.parametrize("held", [False, True], ids=["linear", "held"])
@pytest.mark.parametrize("delay", DELAYS)
def test_moments_of_the_delayed_input(delay, held):
    data = record(30)
    made = cut(data)
    whole, windows = made.delayed_inputs(np.array([delay * STEP]))
    u = measured_input(data["u"], held)
    for k in range(29):
        mean, change, now = input_over_step(windows[:, k], delay - whole[0, k], held)
        breaks = [b for b in (delay % 1,) if 0 < b < 1]

        def late(t, k=k):
            return u(k + t - delay)

        wanted = quad(late, 0, 1, points=breaks or None, epsabs=1e-12)[0]
        moment = quad(lambda t: late(t) * (t - 0.5), 0, 1, points=breaks or None, epsabs=1e-12)[0]
        assert_allclose(mean, wanted, atol=1e-8)
        assert_allclose(change, 12 * moment, atol=1e-7)  # the slope of the best line
        assert_allclose(now, late(0), atol=1e-8)


def test_moments_and_their_slope_are_continuous_where_a_whole_sample_is_passed():
    data = record(30)
    made = cut(data)

    def moments(delay):
        whole, windows = made.delayed_inputs(np.array([delay * STEP]))
        return np.array(
            [input_over_step(windows[:, k], delay - whole[0, k], False)[:2] for k in range(28)]
        )

    for delay in (1.0, 2.0, 5.0):
        h = 1e-5
        left, middle, right = (moments(delay + x) for x in (-h, 0, h))
        assert_allclose(left, right, atol=1e-4)
        assert_allclose((middle - left) / h, (right - middle) / h, atol=2e-3)


def test_a_delay_beyond_the_record_keeps_the_first_value():
    data = record(20)
    whole, windows = cut(data).delayed_inputs(np.array([50 * STEP]))
    assert_allclose(windows[:, :20], data["u"][0])
    assert np.all(np.abs(whole) <= 20)


def test_the_steps_of_the_whole_record_come_back():
    data = record(60)
    made = cut(data)
    assert made.segment_counts == [9]
    assert made.segments == 9
    assert made.measured.shape == (1, 63)
    assert_allclose(made.measured[0, :60], data["y"])
    assert np.isnan(made.measured[0, 60:]).all()
    assert_allclose(made.steps, STEP)
    assert made.begins_stretch.tolist() == [True] + 8 * [False]
    assert made.coupled.tolist() == 8 * [True] + [False]
    (back,) = made.unpadded(made.measured)
    assert_allclose(back[0], data["y"])


def test_gaps_and_missing_inputs_end_a_stretch():
    u = RANDOM.normal(size=60)
    u[20] = np.nan
    data = record(60, u=u)
    time = data.time.copy()
    time[45:] += 1.0
    data = gb.Record(time, data.signals)
    made = cut(data, segment_length=10)
    assert [s.rows[0] for s in made.stretches] == [0, 21, 45]
    assert [len(s) for s in made.stretches] == [20, 24, 15]
    assert made.begins_stretch.tolist() == [True, False, True, False, False, True, False]
    assert made.coupled.tolist() == [True, False, True, True, False, True, False]
    for stretch in made.stretches:
        assert_allclose(stretch.outputs[0], data["y"][stretch.rows[0] :][: len(stretch)])
        assert_allclose(stretch.inputs[0], u[stretch.rows[0] :][: len(stretch)])
        assert_allclose(stretch.step, STEP)
    back = made.unpadded(made.measured)
    assert [b.shape[1] for b in back] == [20, 24, 15]


def test_a_lost_sample_does_not_shift_those_after_it():
    """One step of twice the length: the times must stay right to a small part of a step."""
    data = record(200)
    lost = data.rows(np.delete(np.arange(200), [50, 120]))
    for stretch in cut(lost).stretches:
        times = lost.time[stretch.rows[0]] + stretch.step * np.arange(len(stretch))
        assert_allclose(times, lost.time[stretch.rows[0] :][: len(stretch)], atol=0.05 * STEP)


def test_missing_outputs_stay_missing():
    y = np.arange(60.0)
    y[5:9] = np.nan
    data = record(60, outputs=("y", "z"), y=y)
    made = cut(data, outputs=("y", "z"))
    assert np.isnan(made.measured[0, 5:9]).all()
    assert np.isfinite(made.measured[1, 5:9]).all()
    whole = cut(data, outputs=("y", "z"), complete=True)
    assert np.isnan(whole.measured[:, 5:9]).all()
    assert np.isfinite(whole.measured[:, :5]).all()


def test_the_past_of_a_delay_is_not_compared():
    made = cut(record(60), lead=2.5 * STEP)
    assert np.isnan(made.measured[0, :3]).all()
    assert np.isfinite(made.measured[0, 3:60]).all()


@pytest.mark.parametrize(
    ("u", "masked"),
    [
        (np.repeat([0.0, 1.0], [10, 50]), 0),  # a step
        (np.concatenate([np.zeros(5), RANDOM.normal(size=55)]), 0),
        (np.concatenate([np.zeros(4), RANDOM.normal(size=56)]), 20),
        (
            np.repeat(RANDOM.normal(size=8), 8)[:60],
            20,
        ),  # commands at a lower rate: the past is as unknown
        (np.concatenate([np.zeros(20), np.repeat(RANDOM.normal(size=8), 5)]), 0),
        (np.ones(60), 0),
        (np.repeat([0.0, 1.0, 0.0], [5, 5, 50]), 0),  # a pulse
        (np.repeat([0.0, 1.0, 2.0], [5, 5, 50]), 20),  # a staircase
        (
            np.repeat([0.0, 1.0, 2.0, 3.0], [12, 5, 20, 23]),
            0,
        ),  # the first hold against the shorter half of the others
        (np.repeat([0.0, 1.0, 2.0, 3.0], [9, 5, 20, 26]), 20),
    ],
)
def test_an_input_that_rests_at_the_beginning_has_rested_before(u, masked):
    made = cut(record(60, u=u), lead=20 * STEP)
    assert np.isnan(made.measured[0, :masked]).all()
    assert np.isfinite(made.measured[0, masked:60]).all()


def test_every_input_asks_for_the_past_that_its_own_delay_reaches():
    made = cut(
        record(60, w=np.repeat([0.0, 1.0], [30, 30])), inputs=("u", "w"), lead=[3 * STEP, 20 * STEP]
    )
    assert made.stretches[0].masked == 3
    made = cut(record(60, w=np.arange(60.0)), inputs=("u", "w"), lead=[3 * STEP, 20 * STEP])
    assert made.stretches[0].masked == 20


def test_after_a_gap_the_past_is_unknown_again():
    u = np.concatenate([np.zeros(30), RANDOM.normal(size=60), np.zeros(10), RANDOM.normal(size=20)])
    data = record(120, u=u)
    time = data.time.copy()
    time[60:] += 1.0
    time[90:] += 1.0
    y = np.arange(120.0)
    y[62] = np.nan
    made = cut(gb.Record(time, {"u": u, "y": y}), lead=10 * STEP)
    there = [np.isfinite(s.outputs[0]) for s in made.stretches]
    assert there[0].all()
    assert not there[1][:10].any()
    assert there[1][10:].all()
    assert there[2].all()


def test_no_inputs():
    data = record(60)
    made = cut(data, inputs=())
    whole, windows = made.delayed_inputs(np.zeros(0))
    assert whole.shape == windows.shape == (0, 63)


def test_a_thinned_experiment_is_a_part_of_the_whole():
    data = record(1000)
    made = cut(data, segment_length=10)
    thin = made.excerpts(300)
    assert 200 <= sum(len(s) for s in thin.stretches) <= 400
    assert len(thin.stretches) == 5
    assert thin.stretches[0].rows[0] == 0
    assert thin.stretches[-1].rows[-1] == 999
    for stretch in thin.stretches:
        assert_allclose(stretch.outputs[0], data["y"][stretch.rows[0] :][: len(stretch)])
    assert made.excerpts(2000) is made


def test_two_inputs_with_their_own_delays():
    data = record(40, w=np.arange(40.0))
    made = cut(data, inputs=("u", "w"))
    whole, windows = made.delayed_inputs(np.array([0.0, 3 * STEP]))
    assert_allclose(whole[:, :40], np.broadcast_to([[0], [3]], (2, 40)))
    assert_allclose(windows[1, :40], data["u"])
    assert_allclose(windows[4, 3:40], np.arange(37.0))


def test_filling_up():
    made = SampledData((Stretch(np.zeros((1, 5)), np.zeros((1, 5)), np.arange(5), 0.1),), 4)
    assert_allclose(
        made.padded([np.ones((2, 5))], -1.0), np.array([[1, 1, 1, 1, 1, -1, -1, -1]] * 2)
    )


def jittered(size, n=60):
    time = STEP * (np.arange(n) + np.random.default_rng(3).uniform(-size, size, n))
    return gb.Record(time, {"u": RANDOM.normal(size=n), "y": np.arange(n)})


def test_small_jitter_counts_as_uniform_and_large_keeps_its_steps():
    """Where an input may be delayed, samples are counted; otherwise times count as they are."""
    assert np.ptp(cut(jittered(0.02), lead=0.1).steps) == 0
    assert np.ptp(cut(jittered(0.0002)).steps) == 0
    for size in (0.02, 0.45):
        data = jittered(size)
        assert_allclose(cut(data).steps[0, : len(data) - 1], np.diff(data.time))
    with pytest.raises(ValueError, match=r"not uniform .* prepare the record with rate"):
        cut(data, lead=0.1)


def test_bad_records():
    with pytest.raises(
        ValueError, match=r"never change \(u\) and y is indistinguishable from noise: nothing can"
    ):
        cut(record(u=np.ones(60), y=RANDOM.normal(size=60)))
    assert cut(record(u=np.ones(60))).constant_inputs
    # Of a few samples, a decay looks as rough.
    for samples in (3, 5, 9):
        y = np.exp(-np.linspace(0, 6, samples))
        assert cut(record(samples, u=np.ones(samples), y=y)).constant_inputs
    assert not cut(record()).constant_inputs
    with pytest.raises(ValueError, match="longest delay in the bounds, 5 s"):
        cut(record(), lead=5.0)
    with pytest.raises(ValueError, match="no measured value of y"):
        cut(record(y=np.full(60, np.nan)))
    with pytest.raises(ValueError, match="no measured value of u"):
        cut(record(u=np.full(60, np.nan)))
    hole = np.random.default_rng(0).normal(size=60)
    hole[::2] = np.nan
    with pytest.raises(ValueError, match="no usable stretch"):
        cut(record(u=hole))
    with pytest.raises(ValueError, match=r"no usable stretch.* makes them\. 8 samples dropped\.$"):
        cut(replace(record(2), findings=("8 samples dropped.",)))


def test_stretches_of_a_record_with_ramp_times():
    data = record(50)
    (stretch,) = gapless(data, ("u",), ("y",))
    assert (stretch.rows[0], len(stretch)) == (0, 50)
    assert_allclose(stretch.step, STEP)


def test_excerpts_of_several_stretches_have_shares_of_the_samples():
    """As many pieces of a stretch as its share of five, from its beginning to its end."""
    data = record(1000)
    time = data.time + np.where(np.arange(1000) >= 700, 5.0, 0.0)
    thin = cut(gb.Record(time, data.signals), segment_length=10).excerpts(200)
    assert [len(s) for s in thin.stretches] == [25] * 4 + [50] * 2
    assert [s.rows[0] for s in thin.stretches] == [0, 225, 450, 675, 700, 950]
    for stretch in thin.stretches:
        assert_allclose(stretch.inputs[0], data["u"][stretch.rows])
        assert stretch.step == pytest.approx(STEP)
    assert thin.segment_length == 10
    # At least two segments each, where the stretch has them.
    assert [len(s) for s in cut(record(100), segment_length=9).excerpts(20).stretches] == [18] * 5
    assert [len(s) for s in cut(record(100), segment_length=30).excerpts(20).stretches] == [20] * 5


def test_every_stretch_may_have_delays_of_its_own():
    u = np.random.default_rng(2).normal(size=40)
    u[20] = np.nan
    made = cut(record(40, u=u, w=np.arange(40.0)), inputs=("u", "w"), segment_length=20)
    whole, around = made.delayed_inputs(STEP * np.array([[0.0, 2.0], [1.5, 3.0]]))
    assert_allclose(whole, [[0] * 20 + [2] * 20, [1] * 20 + [3] * 20])
    first, second = made.unpadded(around)
    assert_allclose(first[:3, 5], u[4:7])
    assert_allclose(second[:3, 5], u[21 + 2 : 21 + 5])
    assert_allclose(first[3:, 5], [3, 4, 5])
    assert_allclose(second[3:, 5], [22, 23, 24])
    # Filled up with the last values; a delay below zero looks ahead, at the end at what is last.
    assert_allclose(second[:, -1], around[:, -1])
    ahead = cut(record(10, u=np.arange(10.0)), segment_length=10).delayed_inputs(
        np.array([-3 * STEP])
    )[1]
    assert_allclose(
        ahead,
        [
            [2, 3, 4, 5, 6, 7, 8, 9, 9, 9],
            [3, 4, 5, 6, 7, 8, 9, 9, 9, 9],
            [4, *range(5, 10), *[9] * 4],
        ],
    )


@pytest.mark.parametrize(("delay", "late"), [(0.0, False), (0.9e-3, False), (1.1e-3, True)])
def test_a_held_input_is_late_from_a_thousandth_of_a_step_on(delay, late):
    assert input_over_step([1.0, 2.0, 5.0], delay, True)[2] == (1.0 if late else 2.0)


def test_records_one_after_the_other():
    first, second = cut(record(20)), cut(record(15))
    both = joined([first, second])
    assert [len(s) for s in both.stretches] == [20, 15]
    assert both.segments == 6


def static(data, **options):
    return sampled_data(
        data,
        ("u",),
        ("y",),
        **({"lead": 0.0, "complete": False, "static": True} | options),
    )


def test_of_a_static_model_every_sample_counts():
    u = np.random.default_rng(1).normal(size=7)
    u[[1, 3, 4]] = np.nan
    made = static(record(7, u=u, y=np.ones(7)))
    assert [s.rows.tolist() for s in made.stretches] == [[0], [2], [5, 6]]
    assert all(s.step == pytest.approx(STEP) for s in made.stretches)
    (rows,) = static(gb.Record(None, {"u": u, "y": np.arange(7.0)})).stretches
    assert rows.rows.tolist() == rows.outputs[0].tolist() == [0, 2, 5, 6]
    with pytest.raises(ValueError, match=r"the record has no row with all inputs and an output"):
        static(gb.Record(None, {"u": u, "y": np.where(np.isfinite(u), np.nan, 1.0)}))
    with pytest.raises(
        ValueError, match=r"the record 'made' has no sample with all inputs and an output \(u; y\)"
    ):
        static(record(7, u=u, y=np.where(np.isfinite(u), np.nan, 1.0)))


@pytest.mark.parametrize(
    ("off", "is_uniform"), [(0.24, True), (0.26, False), (-0.24, True), (-0.26, False)]
)
def test_samples_lie_within_a_quarter_of_a_step(off, is_uniform):
    time = STEP * np.arange(60)
    time[30] += off * STEP
    data = gb.Record(time, {"u": RANDOM.normal(size=60), "y": np.arange(60.0)})
    if is_uniform:
        (stretch,) = cut(data, lead=STEP).stretches
        assert len(stretch) == 60
        assert stretch.times is None
    else:
        with pytest.raises(ValueError, match="not uniform"):
            cut(data, lead=STEP)


@pytest.mark.parametrize(("step", "stretches"), [(1.4, 1), (1.6, 2)])
def test_a_step_and_a_half_is_a_gap(step, stretches):
    time = STEP * np.arange(600)
    time[300:] += (step - 1) * STEP
    data = gb.Record(time, {"u": RANDOM.normal(size=600), "y": np.arange(600.0)})
    assert len(gapless(data, ("u",), ("y",), lead=0.0)) == stretches


@pytest.mark.parametrize(("samples", "is_usable"), [(2, False), (3, True)])
def test_three_samples_say_something_of_a_model_with_states(samples, is_usable):
    data = record(samples)
    if is_usable:
        assert [len(s) for s in cut(data).stretches] == [3]
    else:
        with pytest.raises(
            ValueError,
            match="usable stretch, 3 samples in a row with all inputs: give a longer record",
        ):
            cut(data)


@pytest.mark.parametrize(("lead", "masked"), [(2.0, 2), (2.0009, 2), (2.002, 3)])
def test_a_delay_is_whole_samples_to_a_thousandth(lead, masked):
    made = cut(record(60), lead=lead * STEP)
    assert made.stretches[0].masked == masked


def test_outputs_that_never_change_say_nothing():
    with pytest.raises(
        ValueError,
        match=r"the outputs of the record 'made' never change \(y\): nothing can be estimated",
    ):
        cut(record(y=np.full(60, 3.0)))


def test_a_dead_sensor_beside_a_good_one_is_named():
    """Its residuals, with an estimated variance, would decide the fit; one that is missing does
    not take part.
    """
    with pytest.raises(ValueError, match=r"has y = 3 at all times.* leave it out of the record"):
        cut(record(outputs=("y", "z"), y=np.full(60, 3.0)), outputs=("y", "z"))
    assert cut(record(outputs=("y", "z"), y=np.full(60, np.nan)), outputs=("y", "z")).segments
