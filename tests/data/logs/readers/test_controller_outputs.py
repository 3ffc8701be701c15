"""Which signals of a log are held, and for how long."""

import h5py
import numpy as np
import pytest
from synthetic_logs import flight, radio, tlog

import greybox as gb
from greybox.data.logs.readers.controller_outputs import with_holds
from greybox.data.logs.readers.messages import Messages


def holds(name, fields, rate=400.0, **parameters):
    """What is known of the fields of a message."""
    time = np.arange(10) / rate
    group = Messages(name, np.arange(10), time, dict.fromkeys(fields.split(), time))
    (known,) = with_holds([group], parameters)
    return dict(known.hold)


@pytest.mark.parametrize(
    ("message", "held", "sampled", "unknown"),
    [
        ("RATE", "RDes ROut PDes POut YDes YOut ADes AOut", "R P Y A", ""),
        ("ATT", "DesRoll DesPitch DesYaw", "Roll Pitch Yaw", "ErrRP AEKF"),
        ("PIDP", "Tar Err P I D FF DFF", "Act", "Dmod Flags"),
        ("RCOU", "C1 C14", "", ""),
        ("MOTB", "LiftMax ThLimit", "", "BatVolt"),
        ("SIDD", "Targ F", "Gx Az", "Time"),
        ("PSCN", "TPN DVN TAN", "PN VN AN", ""),
        ("IMU[1]", "", "GyrX AccZ", "T"),
        ("SERVO_OUTPUT_RAW", "servo1_raw servo16_raw", "", "port"),
        ("ATTITUDE", "", "roll pitchspeed", ""),
        ("actuator_motors", "control[0]", "", "timestamp_sample"),
        ("actuator_controls_0", "control[3]", "", ""),
        ("vehicle_torque_setpoint[0]", "xyz[2]", "", "timestamp_sample"),
        ("vehicle_angular_velocity", "", "xyz[0]", ""),
    ],
)
def test_outputs_of_a_controller_are_held_and_attitudes_are_not(message, held, sampled, unknown):
    expected = dict.fromkeys(held.split(), np.inf) | dict.fromkeys(sampled.split(), 0.0)
    assert holds(message, f"{held} {sampled} {unknown}") == expected


def test_one_message_alone_tells_no_rate_and_two_do():
    for count, known in ((1, {"P": 0.0}), (2, {"POut": np.inf, "P": 0.0})):
        time = np.arange(count) / 400.0
        group = Messages("RATE", np.arange(count), time, {"POut": time, "P": time})
        assert dict(with_holds([group], {})[0].hold) == known


@pytest.mark.parametrize("name", ["SCHED_LOOP_RATE", "IMU_GYRO_RATEMAX"])
def test_they_last_for_a_pass_of_the_loop(name):
    assert holds("RATE", "POut P", 25.0, **{name: 400.0}) == {"POut": 1 / 400, "P": 0.0}


def test_where_neither_the_log_nor_its_rate_tells_the_pass_it_is_not_known():
    assert holds("RATE", "POut P", 10.0) == {"P": 0.0}
    assert holds("RATE", "POut P", 10.0, IMU_GYRO_RATEMAX=0.0) == {"P": 0.0}


@pytest.mark.parametrize("text", [False, True])
def test_a_dataflash_log(tmp_path, text):
    log = flight(seconds=1.0)
    path = tmp_path / ("made.log" if text else "made.bin")
    path.write_bytes(log.text.encode() if text else log.binary)
    read = gb.read(path)
    assert read["RATE"].hold == dict.fromkeys(("PDes", "POut", "RDes", "ROut"), np.inf) | {
        "P": 0.0,
        "R": 0.0,
    }
    assert read["IMU"].hold == dict.fromkeys(("GyrX", "GyrY", "GyrZ"), 0.0)
    log.add("PARM", 10**7, "SCHED_LOOP_RATE", 400.0, 400.0)
    path.write_bytes(log.text.encode() if text else log.binary)
    record = gb.prepare(gb.read(path), {"u": "RATE.POut", "theta": "ATT.Pitch"})
    assert record.hold == {"u": 1 / 400, "theta": 0.0}


def test_a_telemetry_log(tmp_path):
    (tmp_path / "made.tlog").write_bytes(tlog(radio()))
    read = gb.read(tmp_path / "made.tlog")
    assert read["ATTITUDE"].hold["pitch"] == 0.0
    assert (
        read["SERVO_OUTPUT_RAW"].hold == {}
    )  # ten a second, and the rate of the loop is not known


@pytest.mark.parametrize("separator", [",", ";"])
def test_a_table_says_it_in_its_header(tmp_path, separator):
    rows = [
        "time [s],u [1 held],w [held],theta (rad sampled),v [m/s]",
        *(f"{0.1 * k},{k},1,2,3" for k in range(9)),
    ]
    (tmp_path / "made.csv").write_text("\n".join(rows).replace(",", separator))
    record = gb.read(tmp_path / "made.csv")["made"]
    assert record.hold == {"u": np.inf, "w": np.inf, "theta": 0.0}
    assert record.units == {"u": "1", "w": "", "theta": "rad", "v": "m/s"}


def test_a_file_of_arrays_says_it_with_the_unit(tmp_path):
    with h5py.File(tmp_path / "made.h5", "w") as file:
        file["time"] = np.arange(9) / 10
        file["u"] = np.arange(9.0)
        file["u"].attrs["unit"] = "N held"
    record = gb.read(tmp_path / "made.h5")["made"]
    assert (record.hold, record.units) == ({"u": np.inf}, {"u": "N"})
