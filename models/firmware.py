"""The controllers that a log shows: firmware, gains, rate and filters, for one axis."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

import greybox as gb
from greybox.logs.ardupilot import SYSTEMID_AXES
from greybox.logs.flight_controllers import AXES, named_filters
from greybox.logs.named_columns import in_si
from greybox.logs.px4 import AXES as PX4_AXES
from greybox.models import ardupilot, betaflight, px4
from greybox.models.control_check import check_controller
from greybox.models.digital_filters import SampledLag, SampledLowPass, SampledNotch


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
        ``{"q": "RATE.P", "u": "RATE.POut"}``; a plus adds several. The first setpoint must be
        there.
    factors : mapping of str to float
        Of signals whose unit is not that of the controller.
    start, end : float, s
        Of the test.
    notes : tuple of str
        What the log names and the controllers leave out.
    """

    controllers: tuple
    axis: str
    signals: Mapping[str, str]
    factors: Mapping[str, float]
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
        records = {own: self._located(recording, own) for own in self.signals}
        base = max(records[law.outputs[0]][0][0].between(self.start, self.end).pieces, key=len)
        columns = {}
        for own, terms in records.items():
            columns[own] = np.zeros(len(base))
            for record, name in terms:
                present = np.isfinite(record[name])
                values = np.interp(base.time, record.time[present], record[name][present])
                columns[own] += values * self.factors.get(own, 1.0)
        return gb.Record(base.time, columns)

    def _located(self, recording, own):
        try:
            places = [recording.locate(name) for name in self.signals[own].split("+")]
        except KeyError as error:
            raise ValueError(f"the log does not show its control law: {error.args[0]}") from None
        return [(in_si(record, [name]), name) for record, name in places]

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
        Of ArduPilot (Copter or Plane; PARM), PX4 (ULog), or of Betaflight, a table with the
        settings before the header, as Blackbox Explorer exports it.
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
    known = recording.metadata.get("parameters", {})
    firmware = _plane if recording.metadata.get("vehicle") == "ArduPlane" else _copter
    if "looptime" in known:
        firmware = _betaflight
    elif "MC_PITCHRATE_P" in known:
        firmware = _px4
    parameters = parameters_during(recording, start, end, PREFIXES[firmware](axis))
    try:
        laws, notes, logged = firmware(recording, parameters, axis, start, end)
    except KeyError as error:
        raise ValueError(
            f"{recording.source or 'the recording'} has no parameter {error.args[0]}, so the gains "
            f"of {axis} are not known: log the parameters of the controller."
        ) from None

    outside = dict(signals or {})
    filters = []
    if outside.get("q", "").endswith("_dot") if raw_rate is None else raw_rate:
        raw = outside.get("q", "q")
        filters = _in_series(_gyro_filters(recording, parameters), laws[-1].rate, raw)
        outside["q"] = filters[-1].outside("filtered") if filters else raw
    laws = [_renamed(law, outside) for law in laws]
    return FlownController((*filters, *laws), axis, *logged, start, end, tuple(notes))


def _copter(recording, parameters, axis, start, end):
    laws, notes = ardupilot.copter(parameters, axis, parameters["SCHED_LOOP_RATE"])
    signals = {"u": f"RATE.{axis[0].upper()}Out", "q": f"RATE.{axis[0].upper()}"}
    signals["q_reference"] = f"{signals['q']}Des"
    if _injected(recording, end) == f"mixer {axis}":
        signals["mixer"] = "SIDD.Targ"
    return laws, notes, (signals, {})


def _plane(recording, parameters, axis, start, end):
    scaler = _scaler(recording, start, end)
    laws, notes = ardupilot.plane(parameters, axis, parameters["SCHED_LOOP_RATE"], scaler)
    message = f"PID{axis[0].upper()}"
    terms = "+".join(f"{message}.{term}" for term in ("P", "I", "D", "FF"))
    signals = {"u": terms, "q": f"{message}.Act", "q_reference": f"{message}.Tar"}
    # This message is in degrees; 45 degrees of a surface are a control of one.
    return (
        laws,
        notes,
        (signals, {"u": 1 / 45, "q": math.radians(1), "q_reference": math.radians(1)}),
    )


def _px4(recording, parameters, axis, start, end):
    # An integral-only rate of the gyro would be 400 Hz by default.
    laws, notes = px4.controllers(parameters, axis, parameters.get("IMU_GYRO_RATEMAX", 400.0))
    controls = [c for c in PX4_AXES[axis].controls if c.partition(".")[0] in recording]
    if not controls:
        raise ValueError(f"the log has no control of {axis}: log vehicle_torque_setpoint.")
    signals = {"u": controls[0], "q": PX4_AXES[axis].rates[0]}
    return laws, notes, ({**signals, "q_reference": f"vehicle_rates_setpoint.{axis}"}, {})


def _betaflight(recording, parameters, axis, start, end):
    laws, notes = betaflight.controllers(parameters, axis)
    k = ("roll", "pitch", "yaw").index(axis)
    held = {name for record in recording.values() for name in record.signals}
    # Terms without a gain are not logged; feed-forward is left out on both sides.
    terms = "+".join(name for t in "PID" if (name := f"axis{t}[{k}]") in held)
    signals = {"u": terms or f"axisP[{k}]", "q": f"gyroADC[{k}]", "q_reference": f"setpoint[{k}]"}
    return laws, notes, (signals, {"u": 1 / betaflight.MIXER})


PREFIXES = {
    _copter: lambda axis: [f"ATC_{kind}_{ardupilot.COPTER[axis]}_" for kind in ("RAT", "ANG")],
    _plane: lambda axis: [f"{name}_" for name in ardupilot.PLANE.get(axis, ())],
    _px4: lambda axis: [f"MC_{axis.upper()}RATE_", f"MC_{axis.upper()}_P"],
    _betaflight: lambda axis: [f"{axis}PID", "dterm_"],
}


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


def _injected(recording, end):
    """Return the axis of System Identification mode in a test, such as "mixer pitch"."""
    if "SIDS" not in recording:
        return ""
    record = recording["SIDS"]
    numbers = [int(n) for t, n in zip(record.time, record["Ax"], strict=True) if t <= end]
    return dict(enumerate(SYSTEMID_AXES, 1)).get(numbers[-1], "") if numbers else ""


def _gyro_filters(recording, parameters):
    """Return the filters between the gyro and the rate controller: (class, values)."""
    known = named_filters(recording)
    filters = [
        (SampledNotch, {"center": f.center, "quality": f.quality, "attenuation": f.attenuation})
        for f in known.get("gyro-notch", ())
    ]
    filters += [(SampledLowPass, {"cutoff": f.cutoff}) for f in known.get("gyro-filter", ())]
    for n in (1, 2):  # Betaflight's
        cutoff = parameters.get(f"gyro_lpf{n}_static_hz", 0)
        kind = int(parameters.get(f"gyro_lpf{n}_type", betaflight.PT1))
        if cutoff > 0 and kind == betaflight.BIQUAD:
            filters.append((SampledLowPass, {"cutoff": cutoff}))
        elif cutoff > 0:
            count, correction = betaflight.SERIES[kind]
            filters += count * [(SampledLag, {"cutoff": cutoff * correction})]
    return filters


def _in_series(filters, rate, raw):
    """Return filters as controllers in series, from the signal `raw` to ``q_filtered``."""
    between = [raw, *(f"filtered_{k}" for k in range(1, len(filters))), "q_filtered"]
    return [
        kind(values, rate=rate, signals={"raw": between[k], "filtered": between[k + 1]})
        for k, (kind, values) in enumerate(filters)
    ]


def _scaler(recording, start, end):
    """Return the median of the logged speed scaler of a plane."""
    if "AETR" not in recording or "SS" not in recording["AETR"].signals:
        raise ValueError("the log has no AETR.SS, the speed scaler of the gains: log AETR.")
    values = sorted(recording["AETR"].between(start, end)["SS"])
    return float(values[len(values) // 2])
