"""The plain values that an answer keeps of the spectrum of a manoeuvre."""

import numpy as np

from greybox.compiled.part import Trajectory
from greybox.compiled.transient_part import Along, TransientPart
from greybox.estimate.fitted_part import FittedSpectrum
from greybox.estimate.fitted_record import covariance_unknowns, stated


def fitted_spectrum(part: TransientPart, trajectory: Trajectory | None) -> FittedSpectrum:
    """Return the spectrum of a part with the outputs at the estimate; NaN without one."""
    count = len(part.outputs)
    noise = np.full((count, count), np.nan)
    fitted = np.full((count, len(part.data)), np.nan, complex)
    ends = np.full(len(part.states), np.nan)
    known, full = False, part.problem.criterion.settings["noise"] == "full"
    if trajectory is not None:
        at: Along = trajectory.detail
        noise, fitted, ends = at.covariance.covariance(trajectory.products), at.modelled, at.ends
        known = at.covariance.known is not None
    return FittedSpectrum(
        **stated(part.problem),
        data=part.data,
        fitted=dict(zip(part.outputs, fitted, strict=True)),
        outputs=part.outputs,
        noise=noise,
        ends=dict(zip(part.states, ends.tolist(), strict=True)),
        at={name: float(value) for name, value in part.problem.at.items()},
        nuisances=len(part.states) + covariance_unknowns(count, known=known, full=full),
    )
