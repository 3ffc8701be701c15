"""A response keeps the stretches of the records that it was estimated from, and is refused together with these."""

import numpy as np
import pytest
from declared_models import Lag

import greybox as gb
from greybox.data.frequency_response import Stretch

TRUTH = {"K": 2.0, "T": 0.3}
SWEEP = gb.experiment.sweep(1, 15, duration=40, rate=50, signal="u")
FLIGHT = gb.virtual_flight(
    Lag(), TRUTH, excitation={"u": SWEEP["u"]}, rate=50.0, noise={"y": 0.02}, seed=1
)
EARLY, LATE = FLIGHT.between(0, 20), FLIGHT.between(20, 60)


def periodic():
    signal = gb.experiment.multisine(1, 10, period=5.0, rate=50, signals=("u",), periods=4)
    flown = gb.virtual_flight(
        Lag(), TRUTH, excitation={"u": signal["u"]}, rate=50.0, noise={"y": 0.02}, seed=2
    )
    cut = flown.between(1.0, flown.time[-1])
    return cut, gb.spectral.periodic_response(cut, 5.0, "u", "y")


def test_every_estimate_keeps_checksum_and_interval():
    end = float(FLIGHT.time[-1])
    response = gb.spectral.spectral_response([EARLY, LATE], "u", "y")
    assert [s.checksum for s in response.stretches] == [FLIGHT.checksum] * 2
    assert [(s.start, s.end) for s in response.stretches] == [(0.0, 20.0), (20.0, end)]

    schedule = gb.experiment.sine_schedule([2.0, 5.0], 1.0, rate=50, signal="u")
    flown = gb.virtual_flight(
        Lag(), TRUTH, excitation={"u": schedule["u"]}, rate=50.0, noise={"y": 0.02}, seed=3
    )
    segments = [gb.data.Segment(q.settled, q.end, "sine", "u", q.low) for q in schedule.schedule]
    found = gb.spectral.finite_frequency(flown, segments, input="u", output="y")
    assert [(s.start, s.end) for s in found.response.stretches] == [
        (p.start, p.end) for p in found.points
    ]

    cut, response = periodic()
    (stretch,) = response.stretches
    whole = (stretch.end - stretch.start + cut.step) / 5.0
    assert whole == pytest.approx(round(whole))  # the remainder at the beginning is left out
    assert stretch.end == cut.time[-1]


def test_the_same_data_are_refused_and_others_are_not():
    response = gb.Problem(Lag(), gb.spectral.spectral_response(EARLY, "u", "y"), name="spectrum")
    for record in (FLIGHT, EARLY, FLIGHT.between(19.9, 30)):
        for total in ((gb.Problem(Lag(), record), response), (response, gb.Problem(Lag(), record))):
            with pytest.raises(
                ValueError, match=r"'spectrum' was estimated from 0 to 20 s of the record .* twice"
            ):
                sum(total)
    for other in (
        LATE,
        gb.virtual_flight(Lag(), TRUTH, excitation={"u": SWEEP["u"]}, rate=50.0, seed=9),
    ):
        assert len((response + gb.Problem(Lag(), other)).parts) == 2
    assert len((response + response.with_(name="again")).parts) == 2


def test_derived_responses_keep_their_origin():
    response = gb.spectral.spectral_response(EARLY, "u", "y")
    for derived in (
        response.where(response.omega > 2),
        response.times_s("rate"),
        response.over_s(),
    ):
        assert derived.stretches == response.stretches


def test_files_keep_the_origin(tmp_path):
    response = gb.spectral.spectral_response([EARLY, LATE], "u", "y")
    path = tmp_path / "response.csv"
    gb.data.write_response(response, path)
    back = gb.read_response(path)
    assert back.stretches == response.stretches
    np.testing.assert_array_equal(back.response, response.response)

    bare = gb.FrequencyResponse(response.omega, response.response)
    gb.data.write_response(bare, path, *())
    assert gb.read_response(path).stretches == ()


def test_a_result_keeps_the_origin(tmp_path):
    response = gb.spectral.spectral_response(EARLY, "u", "y")
    gb.save(gb.fit(gb.Problem(Lag(), response), starts=[TRUTH]), tmp_path / "fit.h5")
    data = gb.load(tmp_path / "fit.h5").parts[0].data
    assert data.stretches == response.stretches
    with pytest.raises(ValueError, match="twice"):
        gb.Problem(Lag(), data) + gb.Problem(Lag(), FLIGHT)


def test_comments_that_only_look_like_an_origin_are_comments(tmp_path):
    path = tmp_path / "response.csv"
    path.write_text(
        "# stretch of luck: 7\n# stretch 1: abc from to\n# stretch 2: abc 0.5 2\nomega_rad_s,alpha,beta\n1,2,3\n"
    )
    assert gb.read_response(path).stretches == (Stretch("abc", 0.5, 2.0),)


def test_a_stretch_that_ends_before_it_begins_is_refused():
    with pytest.raises(ValueError, match="a stretch runs from 3 to 2 s"):
        Stretch("abc", 3, 2)
