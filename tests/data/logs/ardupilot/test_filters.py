"""Filters of the flight controller, held against the firmware's own recurrences, run sample by sample."""

import math

import numpy as np
import pytest
from scipy.signal import freqz

import greybox as gb
from greybox.data.logs.flight_controllers import named_filters, passed_filters
from greybox.data.logs.known_filters import FirstOrderLowPass, LowPass, from_text, in_series
from greybox.data.record import Record, Recording
from greybox.workflows.identification.identify import filter_model

OMEGA = np.array([5.0, 40.0, 200.0, 300.0, 500.0])
RATE = 8000.0  # Hz, high enough for the digital filter to be the continuous one


def log(records=None, **parameters):
    records = records or {"ATT": Record([0.0], {})}
    return Recording(records, metadata={"parameters": parameters})


def firmware_notch(center, width, attenuation, omega):
    """NotchFilter.cpp: init() with center, bandwidth and attenuation, as written there."""
    a = 10 ** (-attenuation / 40)
    octaves = 2 * math.log2(center / (center - width / 2))
    q = math.sqrt(2**octaves) / (2**octaves - 1)
    phase = 2 * math.pi * center / RATE
    alpha = math.sin(phase) / (2 * q)
    b = [1 + alpha * a**2, -2 * math.cos(phase), 1 - alpha * a**2]
    return freqz(
        b, [1 + alpha, -2 * math.cos(phase), 1 - alpha], worN=omega, fs=2 * math.pi * RATE
    )[1]


def response(filters, omega=OMEGA):
    return np.prod(
        [gb.frequency_response(filter_model(known), {}, omega).response for known in filters],
        axis=0,
    )


def test_the_harmonic_notch_is_that_of_the_firmware():
    known = named_filters(
        log(
            INS_GYRO_FILTER=40,
            INS_HNTCH_ENABLE=1,
            INS_HNTCH_FREQ=50,
            INS_HNTCH_BW=25,
            INS_HNTCH_ATT=40,
            INS_HNTCH_HMNCS=5,
        )
    )
    single = firmware_notch(50, 25, 40, OMEGA)
    third = firmware_notch(150, 75, 40, OMEGA)  # the third harmonic has the quality of the first
    assert len(known["gyro-notch"]) == 2
    assert response(known["gyro-notch"]) == pytest.approx(single * third, rel=0.01)
    assert known["gyro-filter"] == (LowPass(40.0),)


def test_a_double_notch_lies_on_both_sides_of_the_center():
    setting = {
        "INS_GYRO_FILTER": 20,
        "INS_HNTCH_ENABLE": 1,
        "INS_HNTCH_FREQ": 80,
        "INS_HNTCH_BW": 40,
        "INS_HNTCH_ATT": 40,
    }
    below, above = named_filters(log(**setting, INS_HNTCH_OPTS=1))["gyro-notch"]
    assert below.center == pytest.approx(80 - 40 / 32)
    assert above.center == pytest.approx(80 + 40 / 32)


def test_a_notch_that_follows_the_motors_lies_where_it_was():
    setting = {
        "INS_GYRO_FILTER": 20,
        "INS_HNTCH_ENABLE": 1,
        "INS_HNTCH_FREQ": 60,
        "INS_HNTCH_BW": 30,
        "INS_HNTCH_ATT": 40,
    }
    throttle = Record([0.0, 1.0, 2.0], {"AOut": [0.0, 0.36, 0.36]})
    by_throttle = log({"RATE": throttle}, **setting, INS_HNTCH_MODE=1, INS_HNTCH_REF=0.25)
    assert named_filters(by_throttle)["gyro-notch"][0].center == pytest.approx(60 * 1.2)
    logged = log(
        {"FTNS[0]": Record([0.0, 1.0], {"NF": [91.0, 93.0]})},
        **setting,
        INS_HNTCH_MODE=3,
        INS_HNTCH_REF=1,
    )
    assert named_filters(logged)["gyro-notch"][0].center == pytest.approx(92)
    assert "gyro-notch" not in named_filters(log(**setting, INS_HNTCH_MODE=3, INS_HNTCH_REF=1))


@pytest.mark.parametrize(
    ("signal", "filtered"), [("RATE.P", True), ("IMU[1].GyrX", True), ("RATE.PDes", False)]
)
def test_rates_have_passed_the_filters_of_the_gyro(signal, filtered):
    flown = log(
        INS_GYRO_FILTER=20, INS_NOTCH_ENABLE=1, INS_NOTCH_FREQ=80, INS_NOTCH_BW=40, INS_NOTCH_ATT=15
    )
    passed = passed_filters(flown, signal)
    assert [str(known) for known in passed] == (
        ["80 Hz notch", "20 Hz low-pass filter"] if filtered else []
    )
    assert passed_filters(Recording({}), signal) == ()


def test_the_filters_of_the_controller_are_those_of_its_axis():
    known = named_filters(
        log(ATC_RAT_PIT_FLTD=20, ATC_RAT_PIT_FLTT=10, ATC_RAT_RLL_FLTD=7), "pitch"
    )
    assert known == {
        "d-term-filter": (FirstOrderLowPass(20.0),),
        "target-filter": (FirstOrderLowPass(10.0),),
    }
    # AC_PID: y += dt / (dt + 1 / (2π f)) (x - y), which is the lag as the loop gets fast.
    step = 1e-5
    alpha = step / (step + 1 / (2 * math.pi * 20))
    expected = freqz([alpha], [1, alpha - 1], worN=OMEGA, fs=2 * math.pi / step)[1]
    assert response(known["d-term-filter"]) == pytest.approx(expected, rel=0.01)


def test_px4_has_its_own():
    flown = log(IMU_GYRO_CUTOFF=30, IMU_GYRO_NF0_FRQ=120, IMU_GYRO_NF0_BW=20, IMU_DGYRO_CUTOFF=20)
    notch, low_pass = passed_filters(flown, "vehicle_angular_velocity.xyz[0]")
    assert (notch.center, notch.quality, low_pass) == (120.0, 6.0, LowPass(30.0))
    at_center = response([notch], np.array([2 * math.pi * 120]))
    assert abs(at_center[0]) < 1e-9


def test_files_name_filters_and_nothing_else():
    known = named_filters(
        log(INS_GYRO_FILTER=20, INS_NOTCH_ENABLE=1, INS_NOTCH_FREQ=80, INS_NOTCH_BW=40)
    )
    for filters in known.values():
        assert from_text(in_series(filters)) == filters
    for text in (
        "os:system('x')",
        "my.py:Class(1)",
        "LowPass(a)",
        "LowPass()",
        "",
        "LowPass(1, 2, 3, 4)",
        "Pass(1)",
    ):
        with pytest.raises(ValueError, match="is not known: it must be one of LowPass"):
            from_text(text)


@pytest.mark.parametrize(
    ("options", "parts"), [(0, [0]), (1, [-1, 1]), (16, [-1, 0, 1]), (17, [-1, 0, 1])]
)
def test_double_and_triple_notches_are_spread_over_the_width(options, parts):
    """By width / 32 on either side, each as many times as narrow: HarmonicNotchFilter::set_center_frequency."""
    setting = {
        "INS_GYRO_FILTER": 20,
        "INS_HNTCH_ENABLE": 1,
        "INS_HNTCH_FREQ": 80,
        "INS_HNTCH_BW": 40,
    }
    found = named_filters(log(**setting, INS_HNTCH_OPTS=options, INS_HNTCH_HMNCS=5))["gyro-notch"]
    expected = [k * (80 + part * 40 / 32) for k in (1, 3) for part in parts]
    assert [notch.center for notch in found] == pytest.approx(expected)
    half = 40 / len(parts) / 2
    octave = (80 / (80 - half)) ** 2
    assert found[0].quality == pytest.approx(math.sqrt(octave) / (octave - 1))


HARMONIC = {
    "INS_GYRO_FILTER": 20,
    "INS_HNTCH_ENABLE": 1,
    "INS_HNTCH_FREQ": 60,
    "INS_HNTCH_BW": 30,
    "INS_HNTCH_ATT": 40,
}


def centers(records=None, **changes):
    return [
        notch.center
        for notch in named_filters(log(records, **HARMONIC | changes)).get("gyro-notch", ())
    ]


def quality(center, width):
    """NotchFilter.cpp: from the octaves between both edges."""
    octaves = 2 * math.log2(center / (center - width / 2))
    return math.sqrt(2**octaves) / (2**octaves - 1)


def test_the_static_notch_of_old_firmware():
    setting = {
        "INS_GYRO_FILTER": 20,
        "INS_NOTCH_ENABLE": 1,
        "INS_NOTCH_FREQ": 70,
        "INS_NOTCH_BW": 30,
    }
    (notch,) = named_filters(log(**setting, INS_NOTCH_ATT=15))["gyro-notch"]
    assert (notch.center, notch.quality, notch.attenuation) == (
        70,
        pytest.approx(quality(70, 30)),
        15,
    )
    for without in (
        {"INS_NOTCH_ENABLE": 0},
        {"INS_NOTCH_BW": 0},
        {"INS_NOTCH_BW": 140},
        {"INS_GYRO_FILTER": 0},
    ):
        assert "gyro-notch" not in named_filters(log(**setting | without))


def test_harmonics_are_the_bits_of_their_parameter():
    assert centers() == [60]  # none stated: the first
    assert centers(INS_HNTCH_HMNCS=0b1010) == [120, 240]
    assert centers(INS_HNTCH_HMNCS=0x18001) == [60, 960]  # sixteen bits
    assert centers(INS_HNTCH_BW=119)
    assert centers(INS_HNTCH_BW=120) == centers(INS_HNTCH_BW=0) == centers(INS_HNTCH_ENABLE=0) == []
    (notch,) = named_filters(log(**HARMONIC))["gyro-notch"]
    assert (notch.quality, notch.attenuation) == (pytest.approx(quality(60, 30)), 40)


def test_each_notch_has_its_own_logged_center():
    """The median of what is above zero and a number; of the names without a number, the first notch alone."""
    second = {name.replace("HNTCH", "HNTC2"): value for name, value in HARMONIC.items()} | {
        "INS_HNTC2_FREQ": 75
    }

    def logged(name, field="NF", values=(90.0, 0.0, math.nan, 97.0, 91.0, -5.0)):
        return {name: Record(np.arange(6.0), {field: values})}

    both = logged("FTNS[0]") | logged("FTNS[1]", values=(130.0,) * 6)
    assert centers(both, **second) == [91, 130]
    assert centers(logged("FTNS"), **second) == [91, 75]
    assert centers(logged("FTN", "NF1"), **second) == [91, 75]
    assert centers(logged("FTN[1]", "NF1"), **second) == [60, 91]
    assert centers(logged("FTN[0]", "other"), **second) == [60, 75]
    assert centers(logged("FTNS[0]", values=(0.0,) * 6), **second) == [60, 75]


@pytest.mark.parametrize(
    ("mode", "reference", "throttle", "center"),
    [
        (0, 0.25, (0.0, 0.36, 0.36), 60),  # fixed
        (1, 0.0, (0.0, 0.36, 0.36), 60),  # without a reference it stays
        (1, 0.25, (0.0, 0.0, 0.36, 0.49), 60 * math.sqrt(0.425 / 0.25)),  # the median of the flight
        (1, 0.5, (0.36, 0.36), 60),  # never below the frequency of the parameter
        (1, 0.25, (0.0, 0.0), 60),
        (2, 0.25, (0.36, 0.36), None),
    ],
)
def test_a_notch_that_follows_the_throttle_rises_with_its_root(mode, reference, throttle, center):
    rate = Record(np.arange(len(throttle)), {"AOut": throttle})
    found = centers({"RATE": rate}, INS_HNTCH_MODE=mode, INS_HNTCH_REF=reference)
    assert found == ([] if center is None else [pytest.approx(center)])


@pytest.mark.parametrize(
    "signal", ["vehicle_angular_velocity.xyz[0]", "vehicle_angular_velocity[0].xyz[2]"]
)
def test_px4_has_two_notches_and_a_filter_of_the_d_term(signal):
    flown = log(
        IMU_GYRO_CUTOFF=30,
        IMU_DGYRO_CUTOFF=25,
        IMU_GYRO_NF0_FRQ=120,
        IMU_GYRO_NF0_BW=20,
        IMU_GYRO_NF1_FRQ=210,
        IMU_GYRO_NF1_BW=30,
    )
    passed = passed_filters(flown, signal)
    assert [(k.center, k.quality, k.attenuation) for k in passed[:2]] == [
        (120, 6, 200),
        (210, 7, 200),
    ]
    assert passed[2:] == (LowPass(30.0),)
    assert named_filters(flown)["d-term-filter"] == (LowPass(25.0),)
    assert (
        passed_filters(log(IMU_GYRO_NF0_FRQ=0, IMU_GYRO_NF0_BW=20, IMU_GYRO_CUTOFF=0), signal) == ()
    )
    for width in ({"IMU_GYRO_NF0_BW": 0}, {}):
        assert passed_filters(log(IMU_GYRO_NF0_FRQ=120, **width), signal) == ()


@pytest.mark.parametrize("cutoff", [0.5, 1.0, 0.0, -1.0])
def test_a_cutoff_above_zero_is_a_filter(cutoff):
    parameters = dict.fromkeys(("INS_GYRO_FILTER", "ATC_RAT_YAW_FLTE"), cutoff)
    known = named_filters(log(**parameters), "yaw")
    assert known == (
        {"gyro-filter": (LowPass(cutoff),), "error-filter": (FirstOrderLowPass(cutoff),)}
        if cutoff > 0
        else {}
    )
    px4 = named_filters(log(**dict.fromkeys(("IMU_GYRO_CUTOFF", "IMU_DGYRO_CUTOFF"), cutoff)))
    assert px4 == (
        dict.fromkeys(("gyro-filter", "d-term-filter"), (LowPass(cutoff),)) if cutoff > 0 else {}
    )
    assert centers(INS_HNTCH_ENABLE=0.5) == [60]
    assert centers(INS_HNTCH_FREQ=0.8, INS_HNTCH_BW=0.5) == [0.8]
