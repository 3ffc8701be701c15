"""Comparisons use windows that suit the sample time, say which, and hold against one another what may be compared."""

from types import SimpleNamespace

import numpy as np
import pytest
from drag_flights import QUADRATIC, LinearDrag, QuadraticDrag, fitted, flight
from scipy.signal import lfilter

import greybox as gb
from greybox.assessment.validation import held_out

pytestmark = pytest.mark.usefixtures("unjudged_file")


@pytest.fixture(scope="module")
def flights():
    """The quadratic and the linear model fitted to one flight of quadratic drag, and another flight."""
    record = flight(QUADRATIC, 1)
    return fitted(QuadraticDrag(), record), fitted(LinearDrag(), record), flight(QUADRATIC, 2)


class Room(gb.StateSpace):
    """Temperature of a room from that outside, in hours as houses are: slow samples."""

    states, inputs, outputs = ("inside",), ("outside",), ("inside",)
    tau = gb.Parameter(5e4, bounds=(1e3, 1e6), unit="s")
    gain = gb.Parameter(0.9, bounds=(0, 10))

    def derivative(self, x, u, p):
        return ((p.gain * u.outside - x.inside) / p.tau,)

    def output(self, x, u, p):
        return (x.inside,)


class RoomLog(Room):
    """The same with a logarithmic scale."""

    tau = gb.Parameter(9e4, bounds=(1e3, 1e6), unit="s", scale="log")


class LateRoom(Room):
    """With a delay that may be hours."""

    delay = gb.Parameter(3600.0, bounds=(0, 6 * 3600.0), unit="s")
    delays = {"outside": "delay"}


def days(hours=400, noise=0.1, seed=0):
    time, random = 3600.0 * np.arange(hours), np.random.default_rng(seed)
    outside = lfilter([0.3], [1, -0.95], random.normal(size=hours))
    inside = gb.simulate(Room(), {"tau": 4e4, "gain": 1.0}, gb.Record(time, {"outside": outside}))[
        "inside"
    ]
    return gb.Record(
        time,
        {"outside": outside, "inside": inside + noise * random.normal(size=hours)},
        name="house",
    )


@pytest.fixture(scope="module")
def rooms():
    """One model declared twice, fitted to one slow record."""
    record = days()
    return record, fitted(Room(), record), fitted(RoomLog(), record)


def test_windows_follow_the_sample_time_and_one_model_is_as_good_as_itself(rooms):
    record, one, other = rooms
    found = gb.compare(one, other, records=days(300, seed=1))
    text = str(found)
    assert "identification data: 39 windows of 36000 s, each from 36000 s before it" in text
    prediction = found.predictions["identification"][0][0]
    assert prediction.ahead.tolist() == [3600.0 * k for k in range(1, 11)]
    for data in ("the identification data", "held-out data"):
        assert f"Room and RoomLog predict {data} equally well" in text
    assert "Room and RoomLog fit the data equally well" in text
    single = gb.predict(one, record=record, horizon=3600.0, lead=7200.0)
    assert (
        "windows of 3600 s in house, the state of each estimated from the 7200 s before it"
        in str(single)
    )
    assert str(single).count("after ") == 1
    assert gb.predict(one, record=record).horizon == 36000.0
    # A small difference in every window is one all the same.
    worse = fitted(Room(), record, fixed={"gain": one.estimate["gain"] + 0.05})
    assert "Room 1 predicts the identification data better than Room 2" in str(
        gb.compare(one, worse, labels=["Room 1", "Room 2"])
    )


def test_lengths_are_whole_samples_and_not_less_than_one(rooms, flights):
    record, one, other = rooms
    with pytest.raises(
        ValueError,
        match=r"window=1 s is shorter than a sample of house, 3600 s: give several samples",
    ):
        gb.compare(one, other, window=1.0)
    with pytest.raises(ValueError, match=r"lead=0.5 s is shorter than a sample"):
        gb.predict(one, record=record, lead=0.5)
    found = gb.compare(*flights[:2], window=1.03, lead=0.48)
    first = found.predictions["identification"][0][0]
    assert (first.horizon, first.lead) == pytest.approx((1.05, 0.5))
    assert "windows of 1.05 s, each from 0.5 s before it" in str(found)
    for shift in (0.0, 37.1, 1234.567):  # 12.5 samples in figures that rounding disturbs
        record = flights[2].rows(np.arange(0, 300))
        slow = gb.Record(shift + 0.08 * np.arange(300), dict(record.signals), name="slow")
        assert gb.predict(flights[0], record=slow, horizon=1.0).rows.shape[1] == 12
    few = gb.compare(*flights[:2], window=10.0)
    assert "2 windows cannot show" in str(few)
    mixed = gb.compare(
        *flights[:2],
        window=1.0,
        lead=1.0,
        records=[flights[2], flights[2].rows(np.arange(0, 600, 3))],
    )
    assert "held-out data: 56 windows of 1 to 1.05 s, each from 1 to 1.05 s before it" in str(mixed)


def test_criteria_in_time_are_compared_by_their_likelihoods(rooms):
    record, one, _ = rooms
    other = fitted(Room(), record, criterion=gb.PredictionError())
    found = gb.compare(one, other, labels=["output", "prediction"])
    assert found.value("cost: negative log-likelihood", "output") == one.cost
    assert found.value("cost: negative log-likelihood", "prediction") == other.cost
    assert found.value("AIC", "prediction") == pytest.approx(
        2 * other.cost + 2 * (3 + 2)
    )  # a state, a variance
    late = fitted(LateRoom(), record)
    found = gb.compare(one, late)
    assert found.value("cost", "Room") is None
    assert found.value("fit", "LateRoom", "identification", "inside") > 0
    (said,) = [
        s
        for s in found.statements
        if s.startswith("Costs, AIC and BIC are not compared: Room was fitted to")
    ]
    assert (
        "400 numbers of 'house' and LateRoom to 394 (the longest delay that the bounds allow"
        in said
    )


class Tank(gb.StateSpace):
    """Level by Torricelli's law, which has no value below zero."""

    states, inputs, outputs = ("level",), ("flow",), ("level",)
    k = gb.Parameter(0.5, bounds=(0.1, 2))

    def derivative(self, x, u, p):
        return (u.flow - p.k * gb.sqrt(x.level),)

    def output(self, x, u, p):
        return (x.level,)


class SafeTank(Tank):
    """The same where it runs empty."""

    def derivative(self, x, u, p):
        return (u.flow - p.k * gb.sqrt(gb.maximum(x.level, 0)),)


def test_windows_without_a_finite_value_are_left_out_and_counted():
    time = np.arange(120) / 10.0
    flow = 0.8 + 0.4 * np.sin(time)
    records = []
    for seed, given in enumerate((flow, np.where((time > 2) & (time < 9), 0.0, flow))):
        level = gb.simulate(
            SafeTank(), {"k": 0.6}, gb.Record(time, {"flow": given}), initial={"level": 2.0}
        )["level"]
        level = level + 0.01 * np.random.default_rng(seed).normal(size=time.size)
        records.append(gb.Record(time, {"flow": given, "level": level}, name=f"tank {seed}"))
    fits = [fitted(model, records[0]) for model in (Tank(), SafeTank())]
    found = gb.compare(*fits, records=records[1])
    windows = {kind: len(of_fits[0][0]) for kind, of_fits in found.predictions.items()}
    assert windows["identification"] == 11
    assert 5 < windows["held-out"] < 11
    count = 11 - windows["held-out"]
    (said,) = [
        s
        for s in found.statements
        if s.startswith(f"warning: {count} windows of 11 in tank 1 left out for all models")
    ]
    assert "(Tank is not finite in " in said
    assert "Tank and SafeTank predict held-out data equally well" in str(found)


def test_records_of_the_same_data_are_put_together_by_their_signals():
    time = np.arange(5.0)
    one = gb.Record(
        time, {"u": time, "y": 2 * time}, {"u": "N", "y": "m"}, name="one", hold={"u": 1.0}
    )
    two = gb.Record(time, {"u": 0 * time, "v": 3 * time}, {"v": "m/s"}, name="two", hold={"v": 0.0})
    three = gb.Record(time, {"w": 4 * time}, {"w": "rad"}, name="three")
    found = held_out.with_all_signals([one, two, three])
    assert {name: values[1] for name, values in found.signals.items()} == {
        "u": 1.0,
        "y": 2.0,
        "v": 3.0,
        "w": 4.0,
    }
    assert {name: unit for name, unit in found.units.items() if name != "u"} == {
        "y": "m",
        "v": "m/s",
        "w": "rad",
    }
    assert (found.name, dict(found.hold)) == ("one", {"u": 1.0, "v": 0.0})
    same = held_out.with_all_signals([one, one.with_signals()])
    assert same.signals.keys() == one.signals.keys()


# --- without fits


def made(label, lost, why="", size=None):
    """What `predict_windows` answers, of so many windows."""
    size = len(lost) if size is None else size
    windows = np.arange(size)

    class Made:
        data = gb.Record(np.arange(3.0), {"y": np.zeros(3)}, name="log")
        window = "window"

        def kept(self, chosen):
            return label, windows[chosen].tolist()

    return Made(), np.array(lost), why


def test_windows_in_which_one_is_not_finite_are_left_out_of_all():
    none = [made("a", [False] * 5), made("b", [False] * 5)]
    predictions, notes = held_out.where_all_are_finite(none, ("a", "b"))
    assert predictions == [none[0][0], none[1][0]]
    assert notes == []
    some = [
        made("a", [False, True, False, False, False]),
        made("b", [False, False, False, False, True], "b overflows"),
    ]
    predictions, (note,) = held_out.where_all_are_finite(some, ("a", "b"))
    assert predictions == [("a", [0, 2, 3]), ("b", [0, 2, 3])]
    assert note.startswith("warning: 2 windows of 5 in log")
    assert "(b overflows)" in note
    for lost, said in ((2, "2 windows of 4 in log are"), (1, "1 window of 2 in log is")):
        half = [
            made("one", [True] * lost + [False] * lost, "overflows"),
            made("two", [False] * 2 * lost),
        ]
        with pytest.raises(
            ValueError, match=rf"no comparison .* {said} not finite \(one: overflows\)"
        ):
            held_out.where_all_are_finite(half, ("one", "two"))


def test_lengths_are_those_that_delays_and_samples_ask_for():
    record = gb.Record(np.arange(400) / 50, {"u": np.zeros(400)})
    rows = gb.Record(np.arange(4.0), {"u": np.zeros(4)}, has_time=False)

    def fit(delay):
        return SimpleNamespace(
            at_estimate=lambda **_: SimpleNamespace(delays=np.array([0.1, delay])), records=()
        )

    assert held_out.window_lengths([fit(0.0)], [record, rows], None, None) == (1.0, 0.5)
    assert held_out.window_lengths([fit(0.0), fit(0.4)], [record], None, None) == pytest.approx(
        (1.0, 0.8)
    )
    assert held_out.window_lengths([fit(0.4)], [record], 3.0, 0.2) == (3.0, 0.2)
    assert np.isnan(held_out.window_lengths([fit(0.4)], [rows], None, None)).all()


def test_outputs_are_those_of_all_models_that_the_record_has():
    def model(*outputs):
        return SimpleNamespace(system=SimpleNamespace(outputs=outputs))

    record = gb.Record(np.arange(3.0), {"v": np.zeros(3), "q": np.zeros(3)}, name="log")
    assert held_out.shared_outputs([model("v", "q", "w"), model("w", "v")], record) == ("v",)
    with pytest.raises(
        ValueError, match=r"log has no output that all fits have \(w\); it has v, q"
    ):
        held_out.shared_outputs([model("w", "q"), model("v", "w")], record)
    with pytest.raises(ValueError, match=r"that all fits have \(none\)"):
        held_out.shared_outputs([model("q"), model("v")], record)


def test_a_record_that_one_of_the_fits_has_seen_is_named():
    log = gb.Record(np.arange(10.0), {"v": np.arange(10.0)}, name="log")
    other = gb.Record(np.arange(10.0), {"v": np.ones(10)}, name="other")
    fits = [
        SimpleNamespace(records=[SimpleNamespace(data=d) for d in data])
        for data in ((other,), (other, log))
    ]
    assert held_out.not_held_out(fits, ("a", "b"), [log]) == [
        "warning: log is not held out: b was fitted to samples of it."
    ]
    assert len(held_out.not_held_out(fits, ("a", "b"), [log, other])) == 3
