"""The default choices for a log: which tests, which axis, which control, and which sensor.

Begin with `choose`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.data.excited_segment import Segment, Segments
from greybox.data.files.grouping import unique
from greybox.data.files.wording import some
from greybox.data.logs.axis_signals import NAMES
from greybox.data.logs.flight_controllers import AXES, axis_of
from greybox.data.logs.injected_tests import INJECTED
from greybox.data.logs.segment_detection import announcing, present, stretches
from greybox.data.record import Recording
from greybox.workflows.identification.measurement import Settings, found_tests


@dataclass(frozen=True)
class Choice:
    """A choice, its reason, and the argument that changes it."""

    what: str
    why: str
    argument: str

    def __str__(self) -> str:
        return f"{self.what}: {self.why} ({self.argument}=...)"


def choose(recording: Recording, **stated: Any) -> tuple[Settings, tuple[Choice, ...]]:
    """Return the settings of the measurement, and the choices among them.

    The `stated` settings are kept.

    Raises
    ------
    KeyError, ValueError
        If there is no test, or if the control or the output of its axis is unknown.
    """
    choices = []
    announced = stated.get("announced", "")
    if not announced and not stated.get("setpoint") and "SIDS" not in recording:
        announced = next(iter(announcing(recording)), "")
        if announced:
            choices.append(
                Choice(f"tests of {announced}", "the message announces them", "announced")
            )
    stated["announced"] = announced

    wanted = stated.pop("axis", "")
    has_axis = any(present(recording, (*own.controls, *own.setpoints)) for own in AXES.values())
    # A table has names of its own, and with a period or the whole log there are no tests to choose.
    if stated.get("period") or stated.get("whole") or not has_axis:
        return _as_stated(recording, stated | {"axis": wanted}), tuple(choices)
    settings: dict[str, Any] = stated | {"input": "u", "output": "y"}
    tests = found_tests(recording, Settings(**settings))
    usable = [test for test in tests if test.usable]
    if not usable:
        why = "; ".join(unique(text for test in tests for text in test.findings))
        raise ValueError(
            "no usable test was found in "
            f"{recording.source or 'the log'}{f' ({why})' if why else ''}: give "
            "announced=MESSAGE or setpoint=SIGNAL, or whole=True with the injected "
            "instrument=SIGNAL, input=SIGNAL and output=SIGNAL."
        )
    axes = {
        raw: _body_axis(recording, [t for t in usable if t.axis == raw])
        for raw in {t.axis: 0 for t in usable}
    }
    raw = _chosen_axis(usable, axes, wanted)
    axis = axes[raw]
    used = [test for test in usable if test.axis == raw]
    unused = [axes[name] or name for name in axes if name != raw]
    also = f"; there are tests of {', '.join(unused)} too" if unused else ""
    choices.append(Choice(f"axis {axis or raw}", f"{_why_axis(used[0])}{also}", "axis"))
    # The measurement refuses tests of several axes.
    if unused:
        stated["axis"] = raw

    if not stated.get("input"):
        control = _first(recording, AXES[axis].controls) if axis else ""
        if not control:
            raise ValueError(
                f"no control is known for the axis {raw!r}: give input=u=MESSAGE.Field."
            )
        stated["input"] = f"u={control}"
        choices.append(Choice(f"input {stated['input']}", f"the control of {axis}", "input"))
    if not stated.get("output"):
        stated["output"], why = _output(recording, axis, used)
        choices.append(Choice(f"output {stated['output']}", why, "output"))
    return _as_stated(recording, stated), tuple(choices)


def _as_stated(recording: Recording, stated: dict[str, Any]) -> Settings:
    for name in ("input", "output"):
        if not stated.get(name):
            signals = next(iter(recording.values())).signals if len(recording) == 1 else {}
            signals_text = f"; it has {some([*signals], 12)}" if signals else ""
            raise ValueError(
                f"no {name} is known for this log: give {name}=NAME=SIGNAL{signals_text}."
            )
    return Settings(**stated)


def _first(recording: Recording, signals: Sequence[str]) -> str:
    """Return the first of the signals that the log has; empty without one."""
    return next(iter(present(recording, signals)), "")


def _body_axis(recording: Recording, tests: Segments) -> str:
    """Return the axis that tests excite: by their name, or the one whose setpoint moves most."""
    name = tests[0].axis
    # The axis in a System Identification log is certain, even if it is not one of the three.
    named_axis = axis_of(name) or next((axis for axis in AXES if axis in name.split()), "")
    if named_axis or tests[0].source == "SIDS":
        return named_axis
    # Setpoints first: a loop moves the controls of all axes, but the setpoint of one.
    for signals in ("setpoints", "controls"):
        motions = {
            axis: motion(recording, _first(recording, getattr(names, signals)), tests)
            for axis, names in AXES.items()
        }
        if any(motions.values()):
            return max(motions, key=motions.__getitem__)
    return ""


def motion(recording: Recording, signal: str, tests: Segments) -> float:
    """Return the largest standard deviation of a signal in a test; 0 if the log lacks it."""
    # Stretches of a heading have no jumps by a whole turn at north, which are no motions.
    parts = stretches(recording, signal)[1] if present(recording, [signal]) else []
    spreads = [
        float(np.std(values[inside]))
        for time, values in parts
        for test in tests
        if np.any(inside := (time >= test.start) & (time <= test.end))
    ]
    return max(spreads, default=0.0)


def _chosen_axis(usable: Segments, axes: Mapping[str, str], wanted: str) -> str:
    """Return the axis as its tests name it: the wanted one, or that of the longest tests."""
    if wanted:
        for raw, axis in axes.items():
            if wanted in (raw, axis):
                return raw
        available = ", ".join(axis or raw for raw, axis in axes.items())
        raise ValueError(f"no usable test has the axis {wanted!r}; there are {available}.")
    return max(axes, key=lambda raw: sum(test.duration for test in usable if test.axis == raw))


def _why_axis(test: Segment) -> str:
    if test.source == "SIDS":
        return f"the log of the System Identification mode says {test.axis}"
    if test.source.startswith(INJECTED):
        return f"{test.source.removeprefix(INJECTED)} is injected there"
    return f"{test.axis} moves" if axis_of(test.axis) else "its setpoint moves most"


def _output(recording: Recording, axis: str, used: Segments) -> tuple[str, str]:
    """Return the best-sampled angle of the axis, or else its rate, with a name, and the reason."""
    own = AXES.get(axis)
    kinds = ("angle", "rate")
    groups = zip(kinds, NAMES[axis], (own.angles, own.rates), strict=True) if own else ()
    for kind, name, signals in groups:
        rates = {signal: _rate(recording, signal, used) for signal in present(recording, signals)}
        if not rates or not max(rates.values()):
            continue
        # Signals within 5 % of the fastest are as good: the first of the list is used.
        best = next(signal for signal, rate in rates.items() if rate >= 0.95 * max(rates.values()))
        return f"{name}={best}", f"the {axis} {kind}, at {rates[best]:.4g} Hz"
    raise ValueError(
        f"no angle or rate is known for the axis {axis or used[0].axis!r}: give output=NAME=SIGNAL."
    )


def _rate(recording: Recording, signal: str, used: Segments) -> float:
    """Return the sampling rate during the tests, Hz."""
    time = recording.locate(signal)[0].time
    samples = [
        np.ptp(np.interp((test.start, test.end), time, np.arange(time.size))) for test in used
    ]
    return float(sum(samples) / sum(test.duration for test in used))
