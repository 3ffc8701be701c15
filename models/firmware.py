"""The controllers that a log shows: firmware, gains, rate and filters, for one axis."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

import greybox as gb
from greybox.data.files.folded_text import folded
from greybox.data.intersample import response_of_hold
from greybox.data.logs.ardupilot.signals import SYSTEMID_AXES
from greybox.data.logs.axis_signals import NAMES
from greybox.data.logs.flight_controllers import AXES, axis_of, named_filters, passed_filters
from greybox.data.logs.loop_rate import GYRO_RATE
from greybox.data.logs.px4 import AXES as PX4_AXES
from greybox.modeling.model import require_known
from greybox.models import ardupilot, betaflight, px4
from greybox.models.controller import ControlUnit
from greybox.models.digital_filters import SampledLag, SampledLowPass, SampledNotch
from greybox.workflows.experiment.control_check import ControlCheck, check_controller
from greybox.workflows.experiment.controller import sensors_of
from greybox.workflows.experiment.drawn_loops import drawn_loops
from greybox.workflows.experiment.measured_loop import broken_loop
from greybox.workflows.experiment.required_margins import RANDOM_ERROR
from greybox.workflows.experiment.sampled_loop import DOT, linear_controller
from greybox.workflows.experiment.todays_loop import noise_gain

GAINS = (*ardupilot.GAINS, "K")  # K is PX4's factor of P, I and D
# What is logged of a control of 1, by the message or the column; 45 degrees of a surface are 4500.
CONTROL_UNITS = {"AETR": 4500.0, "axisSum": betaflight.MIXER}
RATE_ALONE = (
    "The fit is of a rate, so that the angle controller is left out: the margins are those of the "
    "rate loop alone. Fit the angle for both."
)
# Filters of the gyro that follow the motors, and are not modeled.
FOLLOWING = ("IMU_GYRO_DNF_EN", "dyn_notch_count", "rpm_filter_harmonics", "gyro_notch_hz")


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
        Features that the log names and the controllers do not model.
    beginnings : mapping of str to str
        How the firmware's names of gains begin, by the class of the controller.
    """

    controllers: tuple
    axis: str
    signals: Mapping[str, str]
    factors: Mapping[str, float]
    start: float = -math.inf
    end: float = math.inf
    notes: tuple = ()
    beginnings: Mapping[str, str] = field(default_factory=dict)

    @property
    def gain_names(self):
        """Parameters of the firmware, such as ``ATC_RAT_PIT_P``, to gains of `gb.safe_gains`."""
        owners = Counter(name for law in self.controllers for name in law.parameters)
        names = {}
        for law in self.controllers:
            kind = type(law).__name__
            for name in [n for n in GAINS if n in law.parameters and kind in self.beginnings]:
                own = name if owners[name] == 1 else f"{kind}.{name}"
                names[self.beginnings[kind] + name] = own
        return names

    @property
    def law(self):
        """The last controller, which gives the control."""
        return [c for c in self.controllers if not isinstance(c, ControlUnit)][-1]

    def check(self, recording):
        """Return the `ControlCheck` of the last controller on a log.

        Raises
        ------
        ValueError
            If the log lacks the error or the control, or the controller is another one.
        """
        return check_controller(self.law, self.record(recording))

    def record(self, recording):
        """Return the signals of the last controller in SI, at the times of its control."""
        law = self.law
        records = {own: self._located(recording, own) for own in self.signals}
        base = max(records[law.outputs[0]][0][0].between(self.start, self.end).pieces, key=len)
        columns = {}
        for own, terms in records.items():
            columns[own] = np.zeros(len(base))
            for record, name in terms:
                present = np.isfinite(record[name])
                values = np.interp(base.time, record.time[present], record[name][present])
                # A log that names the unit has been converted.
                is_converted = record.units.get(name) == "rad/s"
                columns[own] += values * (1.0 if is_converted else self.factors.get(own, 1.0))
        return gb.Record(base.time, columns)

    def sensitivity(self, recording, check):
        """Return the measured response from the signal injected at the mixer to the control.

        `check` has the samples between the log of the injected signal and its effect, without which
        the phase would be wrong. `broken_loop` makes the broken loop of it.
        """
        if "mixer" not in self.signals:
            raise ValueError(
                "nothing was injected at the mixer, so the loop is not measured there: fly a sweep "
                f"of System Identification mode, axis mixer {self.axis}."
            )
        record = self.record(recording)
        rate = round(record.rate)
        grid = np.arange(record.time[0], record.time[-1], 1 / rate)
        injected = record.time + check.late["mixer"] / self.law.rate
        columns = {
            "mixer": np.interp(grid, injected, record["mixer"]),
            "u": np.interp(grid, record.time, record["u"]),
        }
        response = gb.spectral.spectral_response(gb.Record(grid, columns), "mixer", "u")
        # Errors of 1/S are of first order in those of S only where these are small. At the ends of
        # a sweep they are not, and the loop would cross over in noise.
        is_good = response.relative_error < RANDOM_ERROR
        if is_good.sum() < 3:
            raise ValueError(
                f"u is known to {100 * RANDOM_ERROR:g} % at {is_good.sum()} frequencies only: "
                "repeat the sweep, longer or with a larger amplitude."
            )
        return response.where(is_good)

    def loop_gain(self, plant):
        """Return the gain of the loop broken at the control, from a measured response of the plant.

        The signals of the controllers must be the input of the response, its output, or the
        derivative of the output. The errors are those of the response.
        """
        sensors = sensors_of(self.controllers)
        for name in sensors:
            if name.removesuffix(DOT) != plant.output:
                raise ValueError(
                    f"the response is of {plant.output}, not of {name!r}: give "
                    f"signals={{'q': '{plant.output}{DOT}'}}, or measure {name}."
                )
        linear = linear_controller(self.controllers, sensors, (plant.input,))
        if plant.divided_hold:  # this loop holds the control, whatever the fitted flight did
            plant = plant.times(response_of_hold(plant.omega, 1 / self.law.rate))
        s = 1j * plant.omega
        control = linear.response(np.exp(s / self.law.rate))
        control = control[:, linear.commands.index(plant.input)]
        factors = [-control[:, k] * (s if n.endswith(DOT) else 1) for k, n in enumerate(sensors)]
        factor = np.sum(factors, axis=0)
        if not factor.any():
            raise ValueError(
                f"the loop is open: the gains from {' and '.join(sensors)} to {plant.input} are "
                "zero; choose a flight with a controller."
            )
        loop = plant.times(factor)
        return replace(loop, name="the measured response and the controller")

    def _located(self, recording, own):
        try:
            places = [recording.locate(name) for name in self.signals[own].split("+")]
        except KeyError as error:
            raise ValueError(f"the log does not show its control law: {error.args[0]}") from None
        return [(record.in_si([name]), name) for record, name in places]

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
        before the controllers. By default, this is assumed if the rate is a derivative.

    Raises
    ------
    ValueError
        If the log has no gains, or if they changed during the test.
    """
    _require_axis(axis)
    firmware = _firmware(recording, start, end)
    parameters = parameters_during(recording, start, end, PREFIXES[firmware](axis))
    if firmware is _betaflight:
        parameters = betaflight.translated(parameters)
    try:
        laws, notes, logged = firmware(recording, parameters, axis, start, end)
    except KeyError as error:
        raise ValueError(
            f"{recording.source or 'the recording'} has no parameter {error.args[0]}, so the "
            f"controller of {axis} is not known: log its parameters."
        ) from None

    outside = dict(signals or {})
    filters = []
    if outside.get("q", "").endswith("_dot") if raw_rate is None else raw_rate:
        raw = outside.get("q", "q")
        # The filters, too, are those of the time of the test.
        metadata = {**recording.metadata, "parameters": parameters}
        known, missing = _gyro_filters(replace(recording, metadata=metadata), parameters)
        notes += missing
        filters = _in_series(known, laws[-1].rate, raw)
        outside["q"] = filters[-1].outside("filtered") if filters else raw
    laws = [_renamed(law, outside) for law in laws]
    names = BEGINNINGS[firmware](axis)
    return FlownController((*filters, *laws), axis, *logged, start, end, tuple(notes), names)


def _firmware(recording, start, end):
    """Return the function that reads the controllers of the firmware of a log."""
    known = recording.parameters
    if {"looptime", "rollPID"} & {*known}:
        return _betaflight
    vehicle = recording.metadata.get("vehicle")
    if vehicle == "PX4" or "MC_PITCHRATE_P" in known:
        return _px4
    if vehicle != "ArduPlane":
        return _copter
    # Rates of the controllers of a copter are logged while these fly it.
    hovers = "RATE" in recording and len(recording["RATE"].between(start, end)) > 1
    return _quadplane if hovers and "Q_A_RAT_PIT_P" in known else _plane


def _quadplane(recording, parameters, axis, start, end):
    begin = "Q_A_"
    renamed = {f"ATC_{n.removeprefix(begin)}": v for n, v in parameters.items() if begin in n}
    return _copter(recording, parameters | renamed, axis, start, end)


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
    rate = parameters.get("IMU_GYRO_RATEMAX", 0) or 400.0
    laws, notes = px4.controllers(parameters, axis, rate)
    if "IMU_GYRO_RATEMAX" not in parameters:
        notes.append(f"IMU_GYRO_RATEMAX is not in the log: {rate:g} Hz is assumed.")
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
    _quadplane: lambda axis: [
        *(f"Q_A_{kind}_{ardupilot.COPTER[axis]}_" for kind in ("RAT", "ANG")),
        "INS_GYRO_FILTER",
        "INS_HNTC",
    ],
    _copter: lambda axis: [
        *(f"ATC_{kind}_{ardupilot.COPTER[axis]}_" for kind in ("RAT", "ANG")),
        "INS_GYRO_FILTER",
        "INS_HNTC",
    ],
    _plane: lambda axis: [f"{name}_" for name in ardupilot.PLANE.get(axis, ())],
    _px4: lambda axis: [f"MC_{axis.upper()}RATE_", f"MC_{axis.upper()}_P"],
    _betaflight: lambda axis: [f"{axis}PID", "dterm_"],
}


# How the names of gains among the parameters begin, by the class of the controller.
BEGINNINGS = {
    _quadplane: lambda axis: {
        "AngleController": f"Q_A_ANG_{ardupilot.COPTER[axis]}_",
        "RateController": f"Q_A_RAT_{ardupilot.COPTER[axis]}_",
    },
    _copter: lambda axis: {
        "AngleController": f"ATC_ANG_{ardupilot.COPTER[axis]}_",
        "RateController": f"ATC_RAT_{ardupilot.COPTER[axis]}_",
    },
    _plane: lambda axis: {"PlaneRateController": f"{ardupilot.PLANE[axis][0]}_RATE_"},
    _px4: lambda axis: {
        "AngleController": f"MC_{axis.upper()}_",
        "RateController": f"MC_{axis.upper()}RATE_",
    },
    _betaflight: lambda axis: {"RateController": ""},
}


@dataclass(frozen=True, eq=False)
class LoopOfLog:
    """The loop of a fit with the controller that flew: from the model, and measured. It prints.

    Attributes
    ----------
    flown : FlownController
    check : ControlCheck
    model : Margins
    measured : tuple of Margins
        Of the loop broken at the control, measured from the signal injected at the mixer, and from
        the response that the fit was made of; neither contains the model.
    others : tuple of Margins
        Of the model, with the loop broken elsewhere.
    notes : tuple of str
        Where they disagree beyond their errors.
    """

    flown: FlownController
    check: ControlCheck
    model: gb.experiment.Margins
    measured: tuple
    others: tuple
    notes: tuple

    @property
    def is_safe(self):
        """Whether the loop of the model is stable and its controller is the one that flew."""
        return self.check.reproduces and all(m.is_safe for m in (self.model, *self.others))

    def to_dict(self):
        """Return the numbers as plain values."""
        return {
            "controllers": [c.truth for c in self.flown.controllers],
            "control_residual": self.check.residual,
            "samples_late": dict(self.check.late),
            "loops": [answer.to_dict() for answer in (self.model, *self.others)],
            "measured": [answer.to_dict() for answer in self.measured],
            "notes": [*self.flown.notes, *self.notes],
        }

    @property
    def details(self):
        """The controllers with the gains that flew."""
        return str(self.flown)

    def __str__(self):
        measured = (f"By {a.plant}: {note}" for a in self.measured for note in a.notes)
        parts = [
            self.model.beside(*self.measured),
            *measured,
            *self.others,
            self.check,
            *self.notes,
            *self.flown.notes,
        ]
        return folded("\n\n".join(map(str, parts)))


def _require_axis(axis):
    if axis not in AXES:
        raise ValueError(f"the axis {axis!r} is not one of {', '.join(AXES)}.")


def flown_controllers(recording, fit, axis="", *, signals=None):
    """Return the controllers of an axis in a log as the loop of a fit, and their `ControlCheck`.

    The axis is by default that of the logged control of the fit, or pitch.
    Without `signals`, the model's output is the angle, whose derivative is the rate, or the rate if
    its unit or its name is that of one; the angle controller is then left out. A response names the
    signals of the log from which it was made: the control has the unit of that input, and the
    filters of the gyro are in the loop if the output has not passed them.
    """
    model = fit.model_of(0)
    control, sensor = _logged_signals(fit)
    axis = axis or axis_of(control) or "pitch"
    _require_axis(axis)
    tests = [t for t in gb.logs.find_segments(recording) if t.usable and axis in t.axis.lower()]
    start = min((t.start for t in tests), default=-math.inf)
    end = max((t.end for t in tests), default=math.inf)
    names = dict(signals or {})
    if not names:
        angle, rate = NAMES[axis]
        outputs = model.output_names
        first = angle if angle in outputs else outputs[0]
        is_rate = first == rate or model.units.get(first, "") == "rad/s"
        names = {"q": first} if is_rate else {"theta": first, "q": first + DOT}
        if not is_rate and rate in outputs:
            names["q"] = rate
    names.setdefault("u", model.input_names[0])
    unit = _control_unit(recording, axis, control)
    plant_input = names["u"]
    if unit != 1:
        names["u"] = "control"
    raw = _is_raw(recording, sensor)
    flown = from_log(recording, axis, start=start, end=end, signals=names, raw_rate=raw)
    if "theta" not in names and "q" in names:
        used = [c for c in flown.controllers if "theta" not in c.inputs]
        left_out = (RATE_ALONE,) * (len(used) < len(flown.controllers))
        flown = replace(flown, controllers=tuple(used), notes=(*flown.notes, *left_out))
    check = flown.check(recording)
    if unit != 1:
        rate, outside = flown.law.rate, {"u": plant_input}
        converted = ControlUnit({"unit": unit}, rate=rate, signals=outside)
        flown = replace(flown, controllers=(*flown.controllers, converted))
    # The log shows when a rate setpoint acts; the angle controller gives it as much earlier.
    laws = [
        type(c)({**c.values, "delay": check.late["q_reference"]}, rate=c.rate, signals=c.signals)
        if "delay" in c.parameters
        else c
        for c in flown.controllers
    ]
    return replace(flown, controllers=tuple(laws)), check


def _logged_signals(fit):
    """Return the log's names of input and output of a fitted response; empty where unknown."""
    part = fit.parts[0]
    text = getattr(part.data, "about", {}).get("signals", "")
    # Fits of structures to one response leave the names of its signals out.
    names = [pair.partition(" = ")[2] for pair in text.split(", ")]
    return names[:2] if len(names) > 1 else ("", "")


def _control_unit(recording, axis, control):
    """Return the logged value of a control of 1, for a control of the axis."""
    controls = AXES[axis].controls
    if control and control not in controls:
        logged = [name for name in controls if name.partition(".")[0] in recording]
        raise ValueError(
            f"the input of the fit is {control}, which is no control of {axis}: identify the "
            f"response from {' or '.join(logged or controls)}."
        )
    return CONTROL_UNITS.get(control.partition(".")[0].partition("[")[0], 1.0)


def _is_raw(recording, sensor):
    """Return whether a logged rate has not passed the filters of the gyro; None if unknown."""
    if not sensor:
        return None
    is_filtered = sensor.startswith("gyroADC") or bool(passed_filters(recording, sensor))
    return "Unfilt" in sensor or not is_filtered


def loop_of_log(
    recording,
    fit,
    axis="",
    *,
    signals=None,
    broken_at=(),
    level=0.95,
    **settings,
):
    """Return the `LoopOfLog` of a fit and the tests of an axis in a log.

    The loop is broken at the control, where it is measured, and where `broken_at` says; `signals`
    are as in `flown_controllers`, `tracking` and `at` as in `gb.margins`.
    """
    flown, check = flown_controllers(recording, fit, axis, signals=signals)
    of_model, *others = (
        gb.margins(fit, flown.controllers, broken_at=place, level=level, **settings)
        for place in ("", *broken_at)
    )

    loops, refusals = [], []
    data, model = fit.parts[0].data, fit.model_of(0)
    # What was injected went through the angle controller, too.
    if "mixer" in flown.signals and RATE_ALONE not in flown.notes:
        try:
            loop = broken_loop(flown.sensitivity(recording, check))
            loops.append(replace(loop, input=of_model.signal, name="the injected signal"))
        except ValueError as error:
            refusals.append(f"Nothing is measured from the injected signal: {error}")
    # Fits of structures to one response leave its names out.
    if isinstance(data, gb.FrequencyResponse) and not data.output:
        data = replace(data, input=model.input_names[0], output=model.output_names[0])
    read = {name.removesuffix(DOT) for name in sensors_of(flown.controllers)}
    has_errors = isinstance(data, gb.FrequencyResponse) and data.variance is not None
    if has_errors and read == {data.output}:
        loops.append(flown.loop_gain(data))
    measured = tuple(gb.margins(loop, level=level) for loop in loops)
    notes = (*refusals, *disagreements(of_model, measured))
    of_model = replace(of_model, points=tuple(loops))
    return LoopOfLog(flown, check, of_model, measured, tuple(others), notes)


def safe_gains_of_log(fits, recording, gains=(), axis="", *, signals=None, **requirements):
    """Return `gb.safe_gains` of the controllers that a log shows.

    The gains have the names of the firmware: ``{"ATC_RAT_PIT_P": (0.05, 0.3)}``, or names alone for
    ranges about today's; without any, they are P and D of the rate controller, if the log has them
    above 0. `signals` are as in `flown_controllers`, the `requirements` as in `gb.safe_gains`.

    Raises
    ------
    ValueError
        If the controllers do not reproduce the control of the log to a tenth, or have no such gain.
    """
    flown, check = flown_controllers(recording, fits[0], axis, signals=signals)
    if not check.reproduces:
        raise ValueError(f"the loop is not the one that flew. {check}")
    names, law = flown.gain_names, flown.law
    if not gains:
        used = [n for n in ("P", "D") if n in law.parameters and law.values[n] > 0]
        used += [f"{type(law).__name__}.{n}" for n in used]
        gains = [name for name, own in names.items() if own in used]
    require_known(gains, names, "gain", f"the log of {flown.axis}")
    gains = gains if isinstance(gains, Mapping) else dict.fromkeys(gains)
    ranges = {names[name]: ends for name, ends in gains.items()}
    sizes = logged_disturbances(flown, recording, fits[0])
    safe = gb.safe_gains(fits, flown.controllers, ranges, **{**sizes, **requirements})
    return safe.renamed([*gains], flown.notes)


def logged_disturbances(flown, recording, fit):
    """Return ``noise`` and ``moment`` of simulated flights that are like a logged one.

    The moment is as large as the control in the log, whose largest hundredth is left out. The noise
    is that of the rate, white on the samples of the loop, with which the noise of the control is
    that of the log.
    """
    record = flown.record(recording)
    control = record["u"]
    unit = math.prod(c.values["unit"] for c in flown.controllers if isinstance(c, ControlUnit))
    names = {own: fit.parts[0].outside(own) for own in fit.model_of(0).parameters}
    values = {own: fit.estimate[name] for own, name in names.items()}
    loops = drawn_loops(fit.model_of(0), flown.controllers, values, at=fit.parts[0].at, part=0)
    sensor = next((n for n in loops.sensors if n.endswith(DOT)), sensors_of(flown.controllers)[0])
    gain = float(noise_gain(loops, sensor, loops.inputs[0])[0])
    noise = unit * white_noise(control) / gain if gain > 0 else 0.0
    moment = unit * float(np.quantile(np.abs(control - np.median(control)), 0.99))
    return {"noise": {sensor: noise}, "moment": moment}


def white_noise(samples):
    """Return the standard deviation of white noise in samples of a slow signal.

    Fourth differences take out what is slow: at a tenth of the rate, 0.15 of a signal remains.
    """
    return float(np.std(np.diff(samples, 4))) / math.sqrt(70)  # 1, 4, 6, 4, 1 squared


def disagreements(model, measured):
    """Return a sentence for each margin of the model that a measurement contradicts.

    One sentence says so if the loop of the model is unstable, although it flew.

    Values contradict each other if they differ by more than 1.5 times the half lengths of their 95
    % intervals in quadrature, 3 standard errors: several margins are compared.
    """
    if not model.is_stable:
        what = "the model, the gains or the log are wrong"
        return (f"The vehicle flew, but the loop with the model is unstable: {what}.",)
    sentences = []
    for answer in measured:
        for name in ("phase margin", "gain margin", "delay margin", "crossover"):
            row, other = answer[name], model[name]
            # A model that was not fitted has no errors.
            lengths = np.nan_to_num([row.high - row.low, other.high - other.low])
            error = 1.5 * math.hypot(*lengths) / 2
            if abs(row.value - other.value) > error:
                sentences.append(
                    f"Model and measurement disagree on the {name}, {other.value:.3g} and "
                    f"{row.value:.3g} {row.unit}: the model, the gains or the log are wrong."
                )
    return tuple(sentences)


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
    """Return the filters between gyro and rate controller, (class, values), and what is missing."""
    known = named_filters(recording)
    rate = {"gyro_rate": _gyro_rate(parameters)}
    names = ("center", "quality", "attenuation")
    filters = [
        (SampledNotch, dict(zip(names, f.values, strict=True)) | rate)
        for f in known.get("gyro-notch", ())
    ]
    filters += [
        (SampledLowPass, {"cutoff": f.values[0], **rate}) for f in known.get("gyro-filter", ())
    ]
    for n in (1, 2):  # Betaflight's
        lowest = parameters.get(f"gyro_lpf{n}_dyn_hz[0]", 0)
        cutoff = lowest or parameters.get(f"gyro_lpf{n}_static_hz", 0)
        kind = int(parameters.get(f"gyro_lpf{n}_type", betaflight.PT1))
        if cutoff > 0 and kind == betaflight.BIQUAD:
            filters.append((SampledLowPass, {"cutoff": cutoff, **rate}))
        elif cutoff > 0:
            count, correction = betaflight.SERIES[kind]
            filters += count * [(SampledLag, {"cutoff": cutoff * correction})]

    notes = [f"{n} = {parameters[n]:g} is not modeled." for n in FOLLOWING if parameters.get(n)]
    if not filters:
        notes.append("The log names no filter of the gyro, so that none is in the loop.")
    if parameters.get("INS_HNTCH_ENABLE", 0) > 0 and "gyro-notch" not in known:
        notes.append("The frequency of the gyro's notch is unknown, so that it is left out.")
    return filters, notes


def _gyro_rate(parameters):
    """Return the rate in Hz of the gyro and of its filters."""
    if "looptime" in parameters:
        return 1e6 / parameters["looptime"]
    if "INS_GYRO_FILTER" in parameters:
        return GYRO_RATE * 2 ** int(parameters.get("INS_GYRO_RATE", 0))
    return 8 * GYRO_RATE  # usual gyros of PX4; a cutoff of 80 Hz moves by 2 % at an eighth of it


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
