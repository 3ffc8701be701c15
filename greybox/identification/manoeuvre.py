"""From a manoeuvre in a log to the Fourier integrals of its signals, with what was chosen."""

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

# s. States at the ends are estimated, so that neither must be at rest: some samples before, and the
# answer after.
BEFORE, AFTER = 0.5, 2.0


@dataclass(frozen=True, eq=False)
class ManoeuvreMeasurement:
    """What was measured of one manoeuvre.

    Attributes
    ----------
    manoeuvres : tuple of Segment
        Those that were found.
    manoeuvre : Segment
        The chosen one.
    record : Record
        Its signals on one time base, with what came before and after.
    spectrum : TransientSpectrum
    choices : tuple of str
        What was chosen and why, in sentences.
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
            f"{self.spectrum.name}: {pair}, {counted(len(self.spectrum), 'line')} from {low:.4g} to {high:.4g} rad/s",
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
        ``"MESSAGE.Field"``, or with names of one's own ``"u=RATE.POut"``.
    wanted : str
        Its number as `greybox inspect` has it, or its kind where there is only one such.
    setpoint : str
        Signal in which to look for manoeuvres; by default see `find_manoeuvres`, or else the inputs.
    band : (low, high), rad/s, optional
        By default from the first line to where the input fades.
    rate : float, Hz, optional
    held : sequence of str
        Inputs, by name, that keep their values between samples, as the controls of most computers
        do; known of some logs, and otherwise taken as linear between samples, half a sample
        earlier.

    Raises
    ------
    ValueError, KeyError
        If there is no such manoeuvre or signal, or it has gaps.
    """
    signals = named_signals((*inputs, *outputs))
    names, measured = tuple(signals), tuple(signals.values())
    controls = measured[: len(inputs)]
    found = find_manoeuvres(recording, setpoint) or find_manoeuvres(recording, controls)
    if not found:
        raise ValueError(
            f"no manoeuvre was found in {setpoint or ', '.join(controls)}: give "
            "setpoint=SIGNAL, which shows it."
        )
    chosen = chosen_manoeuvre(found, wanted)
    later = [s.start for s in found if s.axis == chosen.axis and s.start > chosen.end]
    start = chosen.start - BEFORE
    end = min(chosen.end + max(AFTER, chosen.duration), *later, math.inf)
    record = prepare(recording, signals, rate, start=start, end=end, held=held)
    highest = HIGHEST * 2 * math.pi / record.step
    limits = band or (0.0, min(chosen.band[1], highest))
    spectrum = transient_spectrum(record, names[: len(inputs)], names[len(inputs) :], limits)
    label = f"{chosen.kind} of {chosen.axis} at {chosen.start:.4g} s"
    spectrum = replace(spectrum, name=label, source=recording.source)
    said = [
        f"from {record.time[0]:.2f} to {record.time[-1]:.2f} s, the answer after the input included."
    ]
    if band is None:
        said.append(
            f"band up to {spectrum.omega[-1]:.4g} rad/s, where the input fades; band=... chooses another."
        )
    unknown = [name for name in names[: len(inputs)] if name not in record.hold]
    if unknown:
        said.append(
            f"{', '.join(unknown)} is taken as linear between samples, as its hold is unknown: give held={unknown[0]} if it "
            f"keeps its values, which makes delays {500 * record.step:.3g} ms shorter."
        )
    controller = controller_in(recording, controls, measured[len(inputs) :])
    if controller:
        said.append(
            f"closed loop ({controller} is in the log): noise of the outputs returns to the inputs, which are taken as "
            "known; where it is not small, estimates are biased."
        )
    return ManoeuvreMeasurement(found, chosen, record, spectrum, tuple(said))
