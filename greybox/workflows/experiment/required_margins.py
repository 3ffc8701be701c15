"""Whether loops of a flight's plants have the required margins, and were measured there.

Begin with `required_margins`.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.assessment.fitted_part import FittedPart, FittedRecord, FittedResponse
from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array, BoolArray, ComplexArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.spectral import spectral_response
from greybox.workflows.experiment.loop_numbers import loop_frequencies, margin_numbers
from greybox.workflows.experiment.sampled_loop import LinearController, SampledLoop

FEW = 16  # draws whose poles are computed

# A point is measured well up to these limits of Tischler and Remple (2012), Aircraft and Rotorcraft
# System Identification, sections 7.5 and 9.7: coherence, relative random error.
COHERENCE, RANDOM_ERROR = 0.6, 0.2
SPACING = 2.0  # of the points that surround a crossover


@frozen
class RequiredMargins:
    """The plants of a flight, and the margins that their loops must have.

    Attributes
    ----------
    name : str
        The flight.
    loops : SampledLoop
        Of the estimate and of draws from its distribution.
    signal : str
        Where the loop is broken.
    wanted : mapping of name to float
        ``phase margin`` in degrees, ``gain margin`` in dB, ``delay`` in s.
    omega : (n,) array, rad/s
    responses : tuple of (plants, n, sensors, inputs) arrays
        The plants there, without and with the additional delay.
    points : (k,) array, rad/s
        Where the response was measured.
    is_good : (k,) array
        Where it was measured well.
    """

    name: str
    loops: SampledLoop
    signal: str
    wanted: Values
    omega: Array
    responses: tuple[ComplexArray, ...]
    points: Array
    is_good: BoolArray

    def judged(self, control: LinearController) -> tuple[float, list[float]]:
        """Return the share of draws that have the margins, and crossovers that were not measured.

        If the estimate itself fails, the share is zero, and no draw is tried. If a crossover was
        not measured, the share is NaN.
        """
        meets, places = self._met(replace(self.loops.first, controller=control))
        if not meets[0]:
            return 0.0, []
        of_all, _ = self._met(replace(self.loops, controller=control))
        share = float(np.mean(of_all[1:]))  # the estimate comes first
        poor = [omega for omega in places if not self._is_measured(omega)]
        # Without a crossover in the band its frequency is 0. It may lie below the band, so it
        # counts as not measured, but there is no frequency to name.
        return math.nan if poor else share, [omega for omega in poor if omega > 0]

    def _met(self, loops: SampledLoop) -> tuple[BoolArray, list[float]]:
        """Return which plants (plants,) meet the requirements, and the crossovers of the first."""
        # A loop becomes unstable only if its gain passes -1, and loops that meet the requirements
        # stay away from it. So the poles of a few draws suffice, which takes a tenth of the time.
        meets = np.ones(len(loops.A), dtype=bool)
        meets[:FEW] = loops.of(slice(FEW)).is_stable
        with_and_without = []
        for response in self.responses:
            gain = loops.broken_at(self.signal, self.omega, response[: len(loops.A)])
            with_and_without.append(margin_numbers(gain, self.omega, period=loops.period))
        # A loop that is stable without the delay is stable for any delay below its delay margin.
        first = with_and_without[0]
        meets &= first["delay margin"].value >= self.wanted["delay"]
        for numbers in with_and_without:
            meets &= numbers["phase margin"].value >= self.wanted["phase margin"]
            meets &= numbers["gain margin"].value >= self.wanted["gain margin"]
            meets &= numbers["gain reduction margin"].value >= self.wanted["gain margin"]
        return meets, [first[name].first[1] for name in ("phase margin", "crossover")]

    def _is_measured(self, omega: float) -> bool:
        """Return whether good points, not far from each other, lie on both sides of a frequency."""
        points, is_good = self.points, self.is_good
        k = int(np.searchsorted(points, omega))
        return 0 < k < len(points) and bool(
            is_good[k - 1] and is_good[k] and points[k] <= SPACING * points[k - 1]
        )

    def cure(self, poor: Sequence[float]) -> str:
        """Return which flight would measure the response at these crossovers; empty for none."""
        if not poor:
            return ""
        return (
            f"In the conditions of {self.name!r}, fly sines or a sweep from "
            f"{min(poor) / SPACING:.2g} to {max(poor) * SPACING:.2g} rad/s, with a larger "
            "amplitude where the points were noisy."
        )


def required_margins(
    fit: Fit, part: int, loops: SampledLoop, signal: str, wanted: Values
) -> RequiredMargins:
    """Return the margins that loops of a fitted part must have where they are broken."""
    omega = loop_frequencies(loops, 260)  # margins to 0.1 degrees
    plants = loops.plant_response(omega)
    responses = [plants]
    if wanted["delay"]:
        responses.append(plants * np.exp(-1j * omega * wanted["delay"])[:, None, None])
    points, is_good = _measured_points(fit.parts[part], loops)
    return RequiredMargins(
        fit.name, loops, signal, wanted, omega, tuple(responses), points, is_good
    )


def _measured_points(part: FittedPart, loops: SampledLoop) -> tuple[Array, BoolArray]:
    """Return the frequencies (n,) of a flight's response, and where it was measured well."""
    nothing = np.zeros(0), np.zeros(0, dtype=bool)
    if isinstance(part, FittedResponse):
        data, fitted = part.data, part.response
    elif isinstance(part, FittedRecord):
        try:
            data = spectral_response(part.data, loops.inputs[0], part.outputs[0])
        except ValueError:  # too short
            return nothing
        place = loops.sensors.index(part.outputs[0])
        fitted = loops.first.plant_response(data.omega)[0, :, place, 0]
    else:
        return nothing

    is_good = np.abs(data.response / fitted - 1) <= 0.3  # 17 degrees
    if data.variance is not None:
        is_good &= data.relative_error <= RANDOM_ERROR
    if data.coherence is not None:
        is_good &= data.coherence >= COHERENCE
    order = np.argsort(data.omega)
    return data.omega[order], is_good[order]
