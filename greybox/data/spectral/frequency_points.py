"""Results of single-sine tests, point by point: values, warnings, tables."""

import math
from dataclasses import dataclass, replace

import numpy as np

from greybox.data.excited_segment import Segment
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.frequency_response import FrequencyResponse

# Change of trim over the amplitude, and standard error over the response: an error of the gain
# about as large as that of harmonics of a tenth.
DRIFTING = 0.3
UNCERTAIN = 0.3


@dataclass(frozen=True)
class FrequencyPoint:
    """The result of one sine test.

    Attributes
    ----------
    omega, response : float, rad/s, and complex
        Output over control, (3.15).
    standard_error, dof : float
        Square root of E|P̂ - P|², both components together (NaN for a single period), and its
        degrees of freedom. It includes the error of the gain due to unexplained harmonics.
    periods, start, end : int and floats, s
        The window of the estimate.
    u, y : complex
        Amplitudes of control and output, phase relative to sin ω(t - segment's start).
    distortion, drift : (float, float)
        For control and output: harmonics over fundamental (root of sum of squares); change of trim
        over the window.
    saturation : float
        Share of time during which the control was at its limit; NaN if unknown.
    findings, notes : tuple of str
        Warnings and remarks.
    unexplained : float
        Harmonics that the plant does not explain, over the control's sine (root of sum of squares);
        NaN if unknown.
    """

    omega: float
    response: complex
    standard_error: float
    dof: float
    periods: int
    start: float
    end: float
    u: complex
    y: complex
    distortion: tuple[float, float]
    drift: tuple[float, float]
    saturation: float
    findings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    unexplained: float = math.nan


@public
@frozen
class FiniteFrequency(Printed):
    """The measured response, the point of each test, and the tests left out with the reason."""

    response: FrequencyResponse
    points: tuple[FrequencyPoint, ...]
    left_out: tuple[tuple[Segment, str], ...] = ()

    @property
    def findings(self) -> tuple[str, ...]:
        """Warnings on points, and messages on the tests that were left out."""
        warnings = [f"{p.omega:g} rad/s: {text}" for p in self.points for text in p.findings]
        omissions = [
            f"{s.kind} from {s.start:.1f} s left out: {reason}" for s, reason in self.left_out
        ]
        return (*warnings, *omissions)

    def with_variance(self, variance: Array | None) -> "FiniteFrequency":
        """Return the points with other variances (n,); None changes nothing."""
        if variance is None:
            return self
        points = [
            replace(p, standard_error=math.sqrt(v))
            for p, v in zip(self.points, variance, strict=True)
        ]
        return replace(
            self, points=tuple(points), response=replace(self.response, variance=variance)
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the points."""
        return tuple(f"{p.omega:g} rad/s: {text}" for p in self.points for text in p.notes)

    @property
    def table(self) -> str:
        """The response and its points, without the findings."""
        header = (
            "rad/s",
            "periods",
            "|u|",
            "|y|",
            "gain",
            "phase °",
            "error %",
            "harmonics u, y %",
            "saturated %",
        )
        return "\n".join(
            [str(self.response), text_table(header, [_row(p) for p in self.points], left=())]
        )

    def __str__(self) -> str:
        return "\n".join([self.table, *self.notes, *self.findings])


def with_findings(point: FrequencyPoint, missing: float) -> FrequencyPoint:
    """Return a point with the warnings that follow from its values.

    `missing` is the share of missing samples in its window.
    """
    findings = [f"{missing:.0%} of the samples are missing"] if missing > 0.05 else []
    names = ("control", "output")
    for name, sine, share, drift in zip(
        names, (point.u, point.y), point.distortion, point.drift, strict=True
    ):
        # For a cubic nonlinearity, y = x + k x³, harmonics of a share h of the fundamental mean
        # that the gain is off by 3h.
        if share > 0.1:
            text = f"the {name} has harmonics of {share:.0%} of its sine"
            findings.append(f"{text}: the response is not linear there")
        if abs(drift) > DRIFTING * abs(sine):
            text = f"the trim of the {name} drifts by {drift:.2g}"
            findings.append(f"{text}, and its amplitude is {abs(sine):.2g}")
    # This is less than the 2.8 % of the time that a sampled sine spends within the
    # resolution of a control of its peaks (`single_sine.RESOLUTION`).
    if point.saturation > 0.02:
        findings.append(f"the control is at its limit for {point.saturation:.0%} of the time")
    if point.periods == 1:
        findings.append("one period only: its error is not known")
    if point.standard_error > UNCERTAIN * abs(point.response):
        share = point.standard_error / abs(point.response)
        findings.append(f"the standard error is {share:.0%} of the response")
    return replace(point, findings=tuple(findings))


def averaged(points: list[FrequencyPoint]) -> FrequencyPoint:
    """Average the tests at one frequency, weighted by periods times squared control amplitude."""
    if len(points) == 1:
        return points[0]
    # These weights are those of least squares over all tests together.
    weight = np.array([p.periods * abs(p.u) ** 2 for p in points])
    weight = weight / weight.sum()
    dof = np.array([p.dof for p in points])

    parts = (weight * [p.standard_error for p in points]) ** 2
    variance = float(parts.sum())
    effective_dof = float(dof.sum())
    if variance > 0 and np.all(dof > 0):  # Welch, Satterthwaite
        effective_dof = float(variance**2 / np.sum(parts**2 / dof))

    return replace(
        points[0],
        response=complex(weight @ [p.response for p in points]),
        standard_error=math.sqrt(variance),
        dof=effective_dof,
        periods=sum(p.periods for p in points),
        findings=unique(text for p in points for text in p.findings),
        notes=(
            f"mean of {len(points)} tests",
            *unique(text for p in points for text in p.notes),
        ),
        # The worst test decides: a nonlinearity does not average out.
        unexplained=float(np.fmax.reduce([p.unexplained for p in points])),
    )


def with_unexplained(point: FrequencyPoint, share: float) -> FrequencyPoint:
    """Return a point with its unexplained harmonics, which count as an error of the gain."""
    if not share > 0:
        return replace(point, unexplained=share)
    # Harmonics of this share change the gain by about as much.
    error = math.hypot(point.standard_error, share * abs(point.response))
    findings = point.findings
    # A share h of harmonics that the plant does not explain counts as a standard error h of the
    # gain: for a clipped sine, the gain is off by h, for a cubic nonlinearity by 3h, and for a
    # rounded sine that other motions carry across the steps, hardly.
    if share > 0.03:
        text = f"the plant does not explain harmonics of {share:.0%} of the control's sine"
        findings = (*findings, f"{text}: it is not linear there")
    return replace(point, unexplained=share, standard_error=error, findings=findings)


def _row(point: FrequencyPoint) -> tuple[str, ...]:
    gain = abs(point.response)
    phase = np.angle(point.response, deg=True)
    return (
        number(point.omega),
        str(point.periods),
        number(abs(point.u), 3),
        number(abs(point.y), 3),
        number(gain, 4),
        f"{phase:.2f}",
        # The error of the gain is one of the two components, as in other tables and figures.
        number(100 * point.standard_error / math.sqrt(2) / gain if gain else math.nan, 2),
        ", ".join(f"{100 * share:.1f}" for share in point.distortion),
        number(100 * point.saturation, 2),
    )
