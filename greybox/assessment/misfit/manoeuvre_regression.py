"""A manoeuvre as a regression of its Fourier integrals on the parameters and on missing terms."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.assessment.misfit.causes.parameters import OWN
from greybox.assessment.misfit.causes.sensors import LATE
from greybox.assessment.misfit.regression import Regression
from greybox.assessment.misfit.response_regression import (
    Order,
    regression_of_curve,
    terms_of_response,
)
from greybox.assessment.misfit.term import ResponseTerm
from greybox.data.files.arrays import Array, ComplexArray, real_and_imaginary
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.transient_part import Along, TransientPart


def regression_of_manoeuvre(
    part: TransientPart,
    trajectory: Trajectory,
    values: Array,
    names: Sequence[str],
    free: Array,
) -> Regression:
    """Return the regression of a manoeuvre at all `values`; the fit moves along `free` (p, d).

    Its integrals at the lines of all outputs follow one another, as those of a response.
    """
    located, outputs = part.located(names), len(part.outputs)
    fitted: Along = trajectory.detail
    # What a model leaves out is smooth along the lines only beside the phase of the modeled output.
    turned = np.exp(-1j * np.angle(fitted.modeled))[..., None]

    def rows(columns: ComplexArray) -> Array:
        columns = columns.reshape(*turned.shape[:2], -1)
        weighted = np.einsum("ka,lab,blc->klc", fitted.weight, fitted.transform, columns)
        return real_and_imaginary(weighted * turned, 1).reshape(2 * turned.size, -1)

    def curve(x: Array) -> tuple[ComplexArray, ComplexArray]:
        parameters, slopes = located(x)
        at = part.along(parameters.full().ravel())
        if at is None:
            raise np.linalg.LinAlgError
        return at.modeled.ravel(), part.modeled_slopes(at, slopes.full()).reshape(-1, len(x))

    omega = np.tile(part.data.omega, outputs)
    # In turbulence, lines are larger here and there, which looks like a mode or a step.
    terms = [term for term in terms_of_response(*omega.tolist()) if term.is_smooth]
    if outputs > 1:
        late = np.repeat(np.eye(outputs), len(part.data), 1) * -1j * omega
        for name, row in zip(part.outputs, late, strict=True):
            terms.append(ResponseTerm(LATE, target=name, values=row))
    regression = regression_of_curve(
        curve,
        part.measured.ravel(),
        rows,
        values,
        names,
        free,
        terms=terms,
        orders=[Order(OWN, part.name, 1.0, is_of_part=True)],
    )
    # The drift of an output leaves what a straight line would.
    lines = np.eye(outputs)[:, None] / (1j * part.data.omega[:, None])
    ends = fitted.to_outputs[:, :, : len(part.states)].swapaxes(0, 1)
    return replace(regression, known=rows(np.concatenate([ends, lines], 2)), pieces=2 * outputs)
