"""From a manoeuvre in a log to the Fourier integrals of its signals, with every choice.

Begin with `measure_manoeuvre`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from greybox.data.record import Record, Recording
from greybox.data.test_segment import Segment, segment_table
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.files.text_table import counted, one_line
from greybox.identification.loop import controller_in
from greybox.identification.measurement import named_signals
from greybox.logs.manoeuvre_detection import chosen_manoeuvre, find_manoeuvres
from greybox.logs.prepare import prepare
from greybox.spectral.transients import HIGHEST, transient_spectrum


@dataclass(frozen=True, eq=False)
class ManoeuvreMeasurement:
    """The measurement of one manoeuvre.

    Attributes
    ----------
    manoeuvres : tuple of Segment
        All manoeuvres of the log.
    manoeuvre : Segment
        The chosen one.
    record : Record
        Its signals on one time base, from shortly before to shortly after it.
    spectrum : TransientSpectrum
    choices : tuple of str
        What was chosen, and why.
    """

    manoeuvres: tuple[Segment, ...]
    manoeuvre: Segment
    record: Record
    spectrum: TransientSpectrum
    choices: tuple[str, ...]

    def __repr__(self) -> str:
        return one_line(
            self,
            self.manoeuvre.kind,
            f"{self.manoeuvre.start:.6g} s",
            f"{len(self.spectrum)} lines",
        )

    def __str__(self) -> str:
        low, high = self.spectrum.omega[[0, -1]]
        pair = f"{', '.join(self.spectrum.inputs)} -> {', '.join(self.spectrum.outputs)}"
        lines = [
            segment_table(self.manoeuvres),
            "",
            f"{self.spectrum.name}: {pair}, {counted(len(self.spectrum), 'line')} from {low:.4g} "
            f"to {high:.4g} rad/s",
            *self.choices,
        ]
        return "\n".join(lines)


def measure_manoeuvre(
    recording: Recording,
    inputs: Sequence[str],
    outputs: Sequence[str],
    wanted: str,
    *,
    setpoint: str = "",
    band: tuple[float, float] | None = None,
    rate: float | None = None,
    held: Sequence[str] = (),
) -> ManoeuvreMeasurement:
    """Return the spectrum of one manoeuvre of a log.

    Parameters
    ----------
    recording : Recording
    inputs, outputs : sequence of str
        ``"MESSAGE.Field"``, or with names of your own ``"u=RATE.POut"``.
    wanted : str
        Its number in the list of `find_manoeuvres`, or its kind if there is only one of that kind.
    setpoint : str
        Signal in which to look for manoeuvres; by default see `find_manoeuvres`, or else the
        inputs.
    band : (low, high), rad/s, optional
        By default from the first line to the frequency at which the input fades.
    rate : float, Hz, optional
    held : sequence of str
        Names of inputs that are held between samples, as most flight controllers hold their
        outputs. Some logs state it; other inputs are taken as linear between samples, half a sample
        earlier.

    Raises
    ------
    ValueError, KeyError
        If the log does not have this manoeuvre or signal, or if it has gaps.
    """
    signals = named_signals((*inputs, *outputs))
    names, measured = tuple(signals), tuple(signals.values())
    controls = measured[: len(inputs)]
    manoeuvres = find_manoeuvres(recording, setpoint) or find_manoeuvres(recording, controls)
    if not manoeuvres:
        raise ValueError(
            f"no manoeuvre was found in {setpoint or ', '.join(controls)}: give "
            "setpoint=SIGNAL, which shows it."
        )
    chosen = chosen_manoeuvre(manoeuvres, wanted)
    # The response must not run into the next manoeuvre, which would be an input that is not seen.
    later = [s.start for s in manoeuvres if s.axis == chosen.axis and s.start > chosen.end]
    # States at the ends are estimated, so the vehicle need not be at rest: a few samples before are
    # enough, and the response after.
    start = chosen.start - 0.5
    end = min(chosen.end + max(2.0, chosen.duration), *later, math.inf)
    record = prepare(recording, signals, rate, start=start, end=end, held=held)
    highest = HIGHEST * 2 * math.pi / record.step
    limits = band or (0.0, min(chosen.band[1], highest))
    spectrum = transient_spectrum(record, names[: len(inputs)], names[len(inputs) :], limits)
    label = f"{chosen.kind} of {chosen.axis} at {chosen.start:.4g} s"
    spectrum = replace(spectrum, name=label, source=recording.source)
    choices = [
        f"from {record.time[0]:.2f} to {record.time[-1]:.2f} s, including the response after the "
        "input."
    ]
    if band is None:
        choices.append(
            f"band up to {spectrum.omega[-1]:.4g} rad/s, where the input fades; band=... chooses "
            "another."
        )
    # Half a sample decides on a delay of some ms, so that an unknown hold is stated.
    unknown = [name for name in names[: len(inputs)] if name not in record.hold]
    if unknown:
        choices.append(
            f"{', '.join(unknown)} is taken as linear between samples, as its hold is unknown: "
            f"give held={unknown[0]} if it "
            f"keeps its values, which makes delays {500 * record.step:.3g} ms shorter."
        )
    controller = controller_in(recording, controls, measured[len(inputs) :])
    if controller:
        choices.append(
            f"closed loop ({controller} is in the log): output noise returns to the inputs, which "
            "are taken as known: if it is not small, the estimates are biased."
        )
    return ManoeuvreMeasurement(manoeuvres, chosen, record, spectrum, tuple(choices))
