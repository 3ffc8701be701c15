"""A multirotor from flight logs: rotors first, then the axes, then both at once.

The commands are known, and feedback makes them depend on earlier moments of the air, which the
gyroscope has shown. Output error would take these for errors of the sensor; prediction error
corrects the rates by every sample of the gyroscope, and is consistent in closed loop. Moments that
last longer than a sample are states of their own.
"""

from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np

import greybox as gb
from greybox.data.logs.prepare import Derived
from greybox.models.multirotor import RATES, SPECIFIC_FORCE, Rotation, Thrust
from greybox.workflows.identification.stages import Stage

RATE = 100.0  # Hz: the anti-alias filter passes 35 Hz, and rotors with a lag of 0.01 s pass 16 Hz
IDLE = 0.2  # mean command below which a vehicle may stand on the ground
PAUSE = 3.0  # s below IDLE that are a part of the flight, such as a fall between two climbs
EDGE = 1.0  # s from and to the ground that are left out
SHORTEST = 3.0  # s of flight that are used
GYRO = 1e-3  # rad/s: no gyroscope on a running motor is quieter at 100 Hz

# Commands from 0 to 1, rates and specific force by firmware: message or topic, and the signs that
# turn axes forward, right, down into forward, left, up.
DIALECTS = {
    "Crazyflie": (
        "fixedFrequency.motor.m{0}",
        lambda c: c / 65535,
        [f"fixedFrequency.gyro.{axis}" for axis in "xyz"],
        [f"fixedFrequency.acc.{axis}" for axis in "xyz"],
        (1, 1, 1),
    ),
    "PX4": (
        "actuator_motors.control[{1}]",
        lambda c: c,
        [f"vehicle_angular_velocity.xyz[{k}]" for k in range(3)],
        [f"sensor_combined.accelerometer_m_s2[{k}]" for k in range(3)],
        (1, -1, -1),
    ),
    "ArduPilot": (
        "RCOU.C{0}",
        lambda c: (c - 1000) / 1000,
        [f"IMU.Gyr{axis}" for axis in "XYZ"],
        [f"IMU.Acc{axis}" for axis in "XYZ"],
        (1, -1, -1),
    ),
}


def flight_records(rotors, recording):
    """Return the flights of a log as records: commands u_k, rates and specific force, at 100 Hz.

    Raises
    ------
    ValueError
        If the log has no signals of a known firmware, or no flight.
    """
    for command, scale, gyro, accelerometer, signs in DIALECTS.values():
        wanted = [command.format(k + 1, k) for k in range(len(rotors))]
        if not all(_has(recording, name) for name in (*wanted, *gyro, *accelerometer)):
            continue
        signals = {f"u_{k}": Derived((name,), scale, "1") for k, name in enumerate(wanted, 1)}
        for names, sources in ((RATES, gyro), (SPECIFIC_FORCE, accelerometer)):
            for name, source, sign in zip(names, sources, signs, strict=True):
                unit = "rad/s" if names is RATES else "m/s²"
                signals[name] = Derived((source,), _turned(sign), unit)
        held = [name for name in signals if name.startswith("u_")]
        record = gb.prepare(recording, signals, RATE, held=held)
        flights = [record.between(*span) for span in airborne(record, held)]
        if not flights:
            raise ValueError(
                f"{recording.source or 'the log'} has no flight of {SHORTEST:g} s: the mean of its "
                f"commands stays below {IDLE:g}."
            )
        return flights
    raise ValueError(
        f"{recording.source or 'the log'} has no commands of {len(rotors)} motors with gyroscope "
        f"and accelerometer of {', '.join(DIALECTS)}: fit records of your own with gb.Problem."
    )


def airborne(record, commands):
    """Return begin and end of every flight in a record, s."""
    flying = np.mean([record[name] for name in commands], axis=0) > IDLE
    time = record.time[flying]
    if not time.size:
        return []
    cuts = np.flatnonzero(np.diff(time) > PAUSE)
    begins, ends = time[np.r_[0, cuts + 1]] + EDGE, time[np.r_[cuts, -1]] - EDGE
    return [(b, e) for b, e in zip(begins, ends, strict=True) if e - b >= SHORTEST]


def flight_stages(rotors, recordings):
    """Return the stages of a fit to the flights of all logs."""
    flights = [flight for log in recordings for flight in flight_records(rotors, log)]
    commands = [f"u_{k}" for k in range(1, len(rotors) + 1)]
    method = gb.MultipleShooting(integrator=gb.RungeKutta(substeps=2))  # of 5 ms

    def thrust(**options):
        # The accelerometer passes a filter of its own, so that its delay is not that of the rates.
        return _several(
            Thrust(rotors, climb=True),
            flights,
            (*commands, "a_z"),
            # A constant climb has the effect of c_0.
            criterion=gb.OutputError(initial={"v_z": 0.0}),
            free=("c_0", "c_1", "T_delay", "a5_z", "a_0"),
            rename={"T_delay": "T_delay_a"},
            **options,
        )

    def rates(axes, free, **options):
        gusts = gb.PredictionError(disturbance=dict.fromkeys(axes, "colored"))
        free = (*(f"delta_{rate}" for rate in axes), *free)
        bounds = {f"v_{rate}": (GYRO, np.inf) for rate in axes}
        model = Rotation(rotors, axes=axes)
        signals = (*commands, *RATES)
        options |= {"criterion": gusts, "free": free, "bounds": bounds}
        return _several(model, flights, signals, **options)

    curve = ("T_rotor", "c_0", "c_1", "c_2")
    return (
        Stage(
            "rotors",
            "lag and thrust curve from the accelerometer along the rotor axes, by output error, "
            "with the drag of the climb, which is zero at the beginning; thrusts are per mass.",
            lambda fits: thrust(),
            4,
            method,
        ),
        Stage(
            "roll and pitch",
            "inertias from the gyroscope, with the lag and the thrust curve of the rotors and "
            "their covariance. Prediction error with colored moments, since feedback through the "
            "gyroscope makes the commands depend on earlier moments.",
            lambda fits: rates("pq", ["T_delay"], fixed=dict.fromkeys(curve, fits["rotors"])),
            1,
            method,
        ),
        Stage(
            "at once",
            "rotors, roll and pitch from both sensors: the gyroscope may move the lag and the "
            "thrust curve, for which the first stage is a prior with its covariance.",
            lambda fits: rates(
                "pq", ["T_delay", "c_0", "c_1"], prior=dict.fromkeys(curve, fits["rotors"])
            ),
            lambda fits: [_joined_estimates(fits, curve)],
            method,
        ),
        Stage(
            "yaw",
            "yaw moment and angular momentum of the rotors, with all values of the stage before "
            "and their covariance. They rest on j_z = (0.93 ± 0.04) (j_x + j_y), as of flat "
            "vehicles, because no flight determines j_z.",
            lambda fits: rates(
                "r",
                ["h", "s_z"],
                fixed=dict.fromkeys((*curve, "j_x", "j_y", "T_delay"), fits["at once"]),
                **FLAT,
            ),
            1,
            method,
        ),
    )


FLAT = {"prior": {"s_z": (0.93, 0.04)}}


def _joined_estimates(fits, curve):
    """Return the rotor values of the first stage and all of the second as a start."""
    rotors, axes = fits["rotors"], fits["roll and pitch"]
    start = {name: rotors.estimate[name] for name in curve if name in rotors.free}
    return start | {name: axes.estimate[name] for name in axes.free}


def _several(model, flights, signals, **options):
    """Return the problem of all flights, with the signals that it needs."""
    problems = []
    for number, flight in enumerate(flights, 1):
        kept = {
            field: {
                name: value for name, value in getattr(flight, field).items() if name in signals
            }
            for field in ("signals", "units", "hold", "filters")
        }
        record = replace(flight, **kept)
        name = f"{model.label}, flight {number}"
        problems.append(gb.Problem(model, record, name=name, **options))
    return reduce(add, problems)


def _has(recording, name):
    try:
        recording.locate(name)
    except (KeyError, ValueError):
        return False
    return True


def _turned(sign):
    return lambda values: sign * values
