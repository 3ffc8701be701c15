"""What single-sine tests gave, point by point: values, warnings in words, tables."""

import math
from dataclasses import dataclass, replace

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.test_segment import Segment
from greybox.files.arrays import Array
from greybox.files.text_table import counted, number, one_line, text_table

# Harmonics over fundamental. Of a cubic nonlinearity, y = x + k x³, harmonics of a share h come
# with a gain 3h off.
NONLINEAR = 0.1

# Harmonics over fundamental that the plant does not explain, from which a warning is due. They
# stand for a standard error of the gain of their own size: of a clipped sine the gain is h off, of
# a cubic nonlinearity 3h, of a sine that is rounded while other motions carry it across the steps
# nearly nothing.
UNEXPLAINED = 0.03

# Change of trim over the amplitude, and standard error over the response: about the size of the
# error in the gain that `NONLINEAR` stands for.
DRIFTING = 0.3
UNCERTAIN = 0.3

# Of the time: less than the 2.8 % during which a sampled sine is as close to its peaks as a control
# can be resolved (`single_sine.RESOLUTION`).
SATURATED = 0.02

# Of the samples of a window that are missing.
MISSING = 0.05


@dataclass(frozen=True)
class FrequencyPoint:
    """What one sine test gave.

    Attributes
    ----------
    omega, response : float, rad/s, and complex
        Output over control, (3.15).
    standard_error, dof : float
        Square root of E|P̂ - P|², both components together (NaN for a single period), and its
        degrees of freedom. The gain error that unexplained harmonics stand for is part of it.
    periods, start, end : int and floats, s
        The window used.
    u, y, r : complex
        Amplitudes of control, output and setpoint (NaN without one), phase relative to sin ω(t -
        segment's start).
    distortion, drift : (float, float)
        Of control and output: harmonics over fundamental (root of sum of squares); change of trim
        over the window.
    saturation : float
        Share of time that the control was at its limit; NaN where it cannot be told.
    findings, notes : tuple of str
        Warnings, and what is worth knowing, in words.
    unexplained : float
        Harmonics that the plant does not explain, over the control's sine (root of sum of squares);
        NaN where they cannot be told.
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
    r: complex
    distortion: tuple[float, float]
    drift: tuple[float, float]
    saturation: float
    findings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    unexplained: float = math.nan


@dataclass(frozen=True, eq=False)
class FiniteFrequency:
    """The measured response, what each test gave, and the tests that gave nothing, with the reason."""

    response: FrequencyResponse
    points: tuple[FrequencyPoint, ...]
    left_out: tuple[tuple[Segment, str], ...] = ()

    @property
    def findings(self) -> tuple[str, ...]:
        """Warnings on points, and the tests that were left out, in words."""
        found = [f"{p.omega:g} rad/s: {text}" for p in self.points for text in p.findings]
        return (
            *found,
            *(f"{s.kind} from {s.start:.1f} s left out: {reason}" for s, reason in self.left_out),
        )

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
        """What is worth knowing of the points, in words."""
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

    def __repr__(self) -> str:
        return one_line(
            self,
            counted(len(self.points), "frequency", "frequencies"),
            f"{len(self.left_out)} left out",
        )

    def __str__(self) -> str:
        return "\n".join([self.table, *self.notes, *self.findings])


def with_findings(point: FrequencyPoint, findings: list[str]) -> FrequencyPoint:
    """Return a point with `findings` and the warnings that its values call for."""
    findings = list(findings)
    names = ("control", "output")
    for name, sine, share, drift in zip(
        names, (point.u, point.y), point.distortion, point.drift, strict=True
    ):
        if share > NONLINEAR:
            findings.append(
                f"the {name} has harmonics of {share:.0%} of its sine: the response is not linear there"
            )
        if abs(drift) > DRIFTING * abs(sine):
            findings.append(
                f"the trim of the {name} drifts by {drift:.2g} where its amplitude is {abs(sine):.2g}"
            )
    if point.saturation > SATURATED:
        findings.append(f"the control is at its limit for {point.saturation:.0%} of the time")
    if point.periods == 1:
        findings.append("one period only: its error is not known")
    if point.standard_error > UNCERTAIN * abs(point.response):
        findings.append(
            f"the standard error is {point.standard_error / abs(point.response):.0%} of the response"
        )
    return replace(point, findings=tuple(findings))


def missing_samples(share: float) -> list[str]:
    """Say that a share of the samples of a window is missing, if it is worth a word."""
    return [f"{share:.0%} of the samples are missing"] if share > MISSING else []


def averaged(points: list[FrequencyPoint]) -> FrequencyPoint:
    """Average the tests at one frequency, weighted by their periods and the square of the control's amplitude."""
    if len(points) == 1:
        return points[0]
    weight = np.array([p.periods * abs(p.u) ** 2 for p in points])
    weight = weight / weight.sum()
    dof = np.array([p.dof for p in points])

    parts = (weight * [p.standard_error for p in points]) ** 2
    variance = float(parts.sum())
    known = variance > 0 and np.all(dof > 0)
    effective_dof = (
        float(variance**2 / np.sum(parts**2 / dof)) if known else float(dof.sum())
    )  # Welch, Satterthwaite

    shares = [p.unexplained for p in points if not math.isnan(p.unexplained)]
    return replace(
        points[0],
        response=complex(weight @ [p.response for p in points]),
        standard_error=math.sqrt(variance),
        dof=effective_dof,
        periods=sum(p.periods for p in points),
        findings=tuple(dict.fromkeys(text for p in points for text in p.findings)),
        notes=(
            f"mean of {len(points)} tests",
            *dict.fromkeys(text for p in points for text in p.notes),
        ),
        unexplained=max(shares, default=math.nan),
    )


def with_unexplained(point: FrequencyPoint, share: float) -> FrequencyPoint:
    """Return a point with the harmonics that the plant does not explain, and the error of the gain they stand for."""
    if not share > 0:
        return replace(point, unexplained=share)
    error = math.hypot(point.standard_error, share * abs(point.response))
    text = f"the plant does not explain harmonics of {share:.0%} of the control's sine: it is not linear there"
    findings = (*point.findings, *([text] if share > UNEXPLAINED else []))
    return replace(point, unexplained=share, standard_error=error, findings=findings)


def _row(point: FrequencyPoint) -> tuple[str, ...]:
    gain = abs(point.response)
    phase = math.degrees(math.atan2(point.response.imag, point.response.real))
    return (
        number(point.omega),
        str(point.periods),
        number(abs(point.u), 3),
        number(abs(point.y), 3),
        number(gain, 4),
        f"{phase:.2f}",
        number(100 * point.standard_error / gain if gain else math.nan, 2),
        ", ".join(f"{100 * share:.1f}" for share in point.distortion),
        number(100 * point.saturation, 2),
    )
