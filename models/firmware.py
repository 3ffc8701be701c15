"""The controllers that a log shows: firmware, gains, rate and filters, for one axis."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

import greybox as gb
from greybox.logs.ardupilot import SYSTEMID_AXES
from greybox.logs.flight_controllers import AXES, named_filters
from greybox.logs.named_columns import in_si
from greybox.models import ardupilot
from greybox.models.control_check import check_controller
from greybox.models.digital_filters import SampledLowPass, SampledNotch


@dataclass(frozen=True, eq=False)
class FlownController:
    """Controllers of one axis with the gains that flew, and the log signals of the last of them.

    Attributes
    ----------
    controllers : tuple of Controller
        In the order in which they run; `gb.margins` takes them.
    axis : str
    signals : mapping of str to str
        Own inputs, setpoints and output of the last controller to signals of the log, such as
        ``{"q": "RATE.P", "u": "RATE.POut"}``. The first setpoint must be there.
    start, end : float, s
        Of the test.
    notes : tuple of str
        What the log names and the controllers leave out.
    """

    controllers: tuple
    axis: str
    signals: Mapping[str, str]
    start: float = -math.inf
    end: float = math.inf
    notes: tuple = ()

    def check(self, recording):
        """Return the `ControlCheck` of the last controller on a log.

        Raises
        ------
        ValueError
            If the log lacks the error or the control, or the controller is another one.
        """
        return check_controller(self.controllers[-1], self.record(recording))

    def record(self, recording):
        """Return the signals of the last controller in SI, at the times of its control."""
        law = self.controllers[-1]
        record, name = self._located(recording, law.outputs[0])
        record = max(record.between(self.start, self.end).pieces, key=len)
        columns = {law.outputs[0]: record[name]}
        for own in (*law.inputs, *law.setpoints):
            if own in self.signals:
                other, name = self._located(recording, own)
                present = np.isfinite(other[name])
                columns[own] = np.interp(record.time, other.time[present], other[name][present])
        return gb.Record(record.time, columns)

    def _located(self, recording, own):
        try:
            record, name = recording.locate(self.signals[own])
        except KeyError as error:
            raise ValueError(f"the log does not show its control law: {error.args[0]}") from None
        return in_si(record, [name]), name

    def __str__(self):
        laws = [
            f"{type(c).__name__}: {', '.join(f'{n} {v:.4g}' for n, v in c.values.items())}"
            for c in self.controllers
        ]
        rate = f"{self.axis}, {self.controllers[-1].rate:g} Hz"
        return "\n".join([f"Controllers of {rate}, gains from the log:", *laws, *self.notes])


def from_log(
    recording, axis="pitch", *, start=-math.inf, end=math.inf, signals=None, raw_rate=None
):
    """Return the `FlownController` of an axis, with the gains in effect from `start` to `end`, s.

    Parameters
    ----------
    recording : Recording
        ArduPilot (PARM) of Copter or Plane.
    axis : "roll", "pitch" or "yaw"
    start, end : float, s
        Of the test, on the log's clock.
    signals : mapping of str to str, optional
        What the plant calls ``theta``, ``q`` and ``u``, where it differs:
        ``{"q": "theta_dot"}`` takes the rate from the derivative of an angle.
    raw_rate : bool, optional
        Whether the rate of the plant has not passed the filters of the gyro, which are then put
        before the controllers. By default that of a derivative has not.

    Raises
    ------
    ValueError
        If the log has no gains, or if they changed during the test.
    """
    if axis not in AXES:
        raise ValueError(f"the axis {axis!r} is not one of {', '.join(AXES)}.")
    about = recording.metadata
    vehicle = about.get("vehicle", "")
    begin = [
        f"ATC_RAT_{ardupilot.COPTER[axis]}_",
        f"ATC_ANG_{ardupilot.COPTER[axis]}_",
        "INS_GYRO_F",
    ]
    if vehicle == "ArduPlane":
        begin = [f"{name}_" for name in ardupilot.PLANE.get(axis, ())]
    parameters = parameters_during(recording, start, end, begin)
    rate = parameters.get("SCHED_LOOP_RATE", 400.0)
    try:
        if vehicle == "ArduPlane":
            laws, notes = ardupilot.plane(parameters, axis, rate, _scaler(recording, start, end))
        else:
            laws, notes = ardupilot.copter(parameters, axis, rate)
    except KeyError as error:
        raise ValueError(
            f"{recording.source or 'the recording'} has no parameter {error.args[0]}, so the gains "
            f"of {axis} are not known: log the parameters of the controller."
        ) from None
    names = AXES[axis]
    logged = {"u": names.controls[0], "q": names.rates[0], "q_reference": names.setpoints[2]}
    if _injected(recording, start, end) == f"mixer {axis}":
        logged["mixer"] = "SIDD.Targ"

    outside = dict(signals or {})
    filters = []
    if outside.get("q", "").endswith("_dot") if raw_rate is None else raw_rate:
        filters = _gyro_filters(recording, axis, rate, outside.get("q", "q"))
        outside["q"] = filters[-1].outside("filtered") if filters else outside.get("q", "q")
    laws = [_renamed(law, outside) for law in laws]
    return FlownController((*filters, *laws), axis, logged, start, end, tuple(notes))


def parameters_during(recording, start, end, begin):
    """Return the parameters in effect from `start` to `end`, s.

    Raises
    ------
    ValueError
        If the log has no parameters, or if one whose name begins with one of `begin` changes.
    """
    about = recording.metadata
    parameters = dict(about.get("parameters", {}))
    if not parameters:
        raise ValueError(
            f"{recording.source or 'the recording'} has no parameters, so the gains that flew are "
            "not known: log them, or give a controller with its gains."
        )
    changed = []
    for time, name, previous, value in reversed(about.get("parameter_changes", ())):
        if time > start:
            parameters[name] = previous
            if time <= end and name.startswith(tuple(begin)):
                changed.append(f"{name} from {previous:g} to {value:g} at {time:.1f} s")
    if changed:
        raise ValueError(
            f"gains changed during the test, {start:.1f} to {end:.1f} s: "
            f"{', '.join(reversed(changed))}; choose a test or a time without changes."
        )
    return parameters


def _renamed(controller, outside):
    names = (*controller.inputs, *controller.setpoints, *controller.outputs)
    signals = {own: outside[own] for own in names if own in outside}
    return type(controller)(dict(controller.values), rate=controller.rate, signals=signals)


def _injected(recording, start, end):
    """Return the axis of System Identification mode in a test, such as "mixer pitch"."""
    if "SIDS" not in recording:
        return ""
    record = recording["SIDS"]
    numbers = [int(n) for t, n in zip(record.time, record["Ax"], strict=True) if t <= end]
    return (
        SYSTEMID_AXES[numbers[-1] - 1] if numbers and 0 < numbers[-1] <= len(SYSTEMID_AXES) else ""
    )


def _gyro_filters(recording, axis, rate, raw):
    """Return the filters of the gyro as controllers in series, from `raw` to ``q_filtered``."""
    known = named_filters(recording, axis)
    kinds = []
    for notch in known.get("gyro-notch", ()):
        values = {
            "center": notch.center,
            "quality": notch.quality,
            "attenuation": notch.attenuation,
        }
        kinds.append((SampledNotch, values))
    kinds += [(SampledLowPass, {"cutoff": f.cutoff}) for f in known.get("gyro-filter", ())]
    between = [raw, *(f"filtered_{k}" for k in range(1, len(kinds))), "q_filtered"]
    return [
        kind(values, rate=rate, signals={"raw": between[k], "filtered": between[k + 1]})
        for k, (kind, values) in enumerate(kinds)
    ]


def _scaler(recording, start, end):
    """Return the median of the logged speed scaler of a plane."""
    if "AETR" not in recording or "SS" not in recording["AETR"].signals:
        raise ValueError("the log has no AETR.SS, the speed scaler of the gains: log AETR.")
    values = sorted(recording["AETR"].between(start, end)["SS"])
    return float(values[len(values) // 2])
