"""Whether the residuals of a simulation are process noise, such as gusts, or noise of sensors.

Gusts reach an output through the dynamics of the model, errors of a sensor do not: the likelihoods
of both were compared for the standard errors, see `greybox.statistics.residual_spectrum`.
"""

from collections.abc import Iterator, Sequence

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.estimate.covariance import Accuracy
from greybox.estimate.diagnostics.records import gust_criterion


def gusts(
    nlp: CompiledProblem, trajectories: Sequence[Trajectory], accuracy: Accuracy, *, noisy: bool
) -> Iterator[str]:
    """Name the records with gusts and the criterion for them, and test sizes that ended at zero.

    Residuals of a wrong model look like gusts, unless noise is most of them.
    """
    for part, trajectory, errors in nlp.rows_of(RecordPart, trajectories, accuracy.parts):
        if part.is_static or errors.colored is None:
            continue
        steady, evidence = trajectory.detail.filter, errors.colored.process_noise
        if part.gains and (steady is None or steady.gain.any()):
            continue
        # A difference of 10 in -2 log evidence is very strong: Kass and Raftery (1995), JASA 90.
        if noisy and part.problem.model.state_names and evidence() > 10.0:
            cure = "start process noise above zero" if part.gains else f"use {gust_criterion(part)}"
            yield (
                f"the residuals of {part.name!r} look like gusts, not like noise of sensors: "
                f"{cure}."
            )
        elif part.gains:
            verdict = "show no process noise" if evidence() < 0 else "hardly show process noise"
            yield (
                f"these data {verdict}: w_{' and w_'.join(part.model.driven)} of {part.name!r} "
                "ended at zero, and OutputError has fewer unknowns."
            )
