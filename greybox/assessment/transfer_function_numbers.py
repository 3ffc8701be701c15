"""The transfer function of a fit with its numbers: gain, poles, zeros and delay with their errors.

Begin with `transfer_function_numbers`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import with_error
from greybox.data.files.printed import Printed
from greybox.data.files.text_table import text_table
from greybox.modeling.factored_form import upper_half
from greybox.modeling.rational import Rational, rational

STEP = 1e-3  # of derivatives, in standard errors: far below the curvature, far above rounding
EXACT = 1e-9  # error over its number
AT_REST = 1e-9  # size of a root at zero, over the largest one


@dataclass(frozen=True)
class TransferNumber:
    """A number of a transfer function.

    Attributes
    ----------
    name, unit : str
    value, standard_error : float
        The error is of first order in those of the parameters; NaN where it is unknown.
    """

    name: str
    unit: str
    value: float
    standard_error: float


@frozen
class TransferFunctionNumbers(Printed):
    """A fitted transfer function with numbers. It prints itself.

    Attributes
    ----------
    input, output : str
    form : str
        Gain, zeros, time constants and delay as one formula.
    numbers : tuple of TransferNumber
        The gain, then poles and zeros, from the slowest: a real one by its value, a complex pair by
        its natural frequency and damping ratio; then the delay.
    """

    input: str
    output: str
    form: str
    numbers: tuple[TransferNumber, ...]

    @property
    def formula(self) -> str:
        """The formula with the names of the signals."""
        return f"{self.output}/{self.input} = {self.form}"

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Return the header and the rows of the table of numbers."""
        rows = [
            [row.name, *with_error(row.value, row.standard_error), row.unit] for row in self.numbers
        ]
        return ["", "value", "± error", "unit"], rows

    def __str__(self) -> str:
        return f"{self.formula}\n\n{text_table(*self.table(), left=(0, 3))}"


def transfer_function_numbers(fit: Fit, part: int = 0) -> TransferFunctionNumbers | None:
    """Return the transfer function of a part of a fit; None if it is not rational, or unknown."""
    fitted = fit.parts[part]
    try:
        model = fit.model_of(part)
        inside = {name: fitted.outside(name) for name in model.parameters}
        at = dict(fitted.at) or None

        def form_of(values: Values) -> Rational:
            own = {name: values[outside] for name, outside in inside.items()}
            return rational(model, own, at=at)

        form = form_of(fit.estimate)
        rows = _with_errors(fit, form, form_of)
    except (LookupError, ValueError, TypeError):
        return None
    return TransferFunctionNumbers(
        model.input_names[0], model.output_names[0], str(form), tuple(rows)
    )


def _with_errors(
    fit: Fit, form: Rational, form_of: Callable[[Values], Rational]
) -> list[TransferNumber]:
    poles, zeros = np.array(upper_half(form.poles)), np.array(upper_half(form.zeros))
    labels = [("gain", ""), *_labels("pole", poles), *_labels("zero", zeros), ("delay", "s")]
    values = _values(form, poles, zeros)
    covariance = fit.covariance
    slopes = np.zeros((len(values), len(fit.names)))
    for k, name in enumerate(fit.names):
        step = STEP * math.sqrt(covariance[k, k])
        if not step > 0:
            continue
        ends = []
        for sign in (1, -1):
            moved = form_of({**fit.estimate, name: fit.estimate[name] + sign * step})
            near_poles, near_zeros = _nearest(poles, moved.poles), _nearest(zeros, moved.zeros)
            ends.append(_values(moved, near_poles, near_zeros))
        slopes[:, k] = (ends[0] - ends[1]) / (2 * step)
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))
    rows = []
    for (name, unit), value, error in zip(labels, values, errors, strict=True):
        if name == "delay" and value == 0:
            continue
        # What rounding leaves of the error of a known number.
        is_exact = error < EXACT * abs(value)
        rows.append(TransferNumber(name, unit, float(value), 0.0 if is_exact else float(error)))
    return rows


def _nearest(roots: ComplexArray, moved: ComplexArray) -> ComplexArray:
    """Return for each root the moved one that is nearest to it, in the upper half plane."""
    nearest = [moved[np.abs(moved - root).argmin()] for root in roots]
    return np.array([root.real + 1j * abs(root.imag) for root in nearest])


def _labels(kind: str, roots: ComplexArray) -> list[tuple[str, str]]:
    """Return names and units: one number for a real root, two for a complex pair."""
    labels = []
    for root in roots:
        if root.imag:
            labels += [(f"{kind}s, natural frequency", "rad/s"), (f"{kind}s, damping ratio", "")]
        else:
            labels.append((kind, "rad/s"))
    return labels


def _values(form: Rational, poles: ComplexArray, zeros: ComplexArray) -> Array:
    """Return the numbers in the order of their labels.

    The gain is that at rest, without the roots at zero.
    """
    numbers = [_gain(form)]
    for roots in (poles, zeros):
        for root in roots:
            if root.imag:
                numbers += [abs(root), -root.real / abs(root)]
            else:
                numbers.append(root.real)
    return np.array([*numbers, float(form.delay)])


def _gain(form: Rational) -> float:
    """Return the ratio of the lowest coefficients that are not zero."""
    lowest = []
    for polynomial in (form.numerator, form.denominator):
        coefficients = np.array(polynomial, dtype=float)
        present = np.abs(coefficients) > AT_REST * np.abs(coefficients).max()
        lowest.append(coefficients[np.flatnonzero(present)[-1]])
    return float(lowest[0] / lowest[1])
