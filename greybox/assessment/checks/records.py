"""What several checks of records ask of them."""

from typing import Any

from greybox.assessment.checks.evidence import Evidence, Pairs
from greybox.assessment.disturbed_state import disturbed_state
from greybox.assessment.fitted_part import FittedRecord
from greybox.data.files.arrays import Array
from greybox.engine.compiled.record_part import RecordPart
from greybox.modeling.colored_disturbance import ColoredDisturbance
from greybox.modeling.disturbance import stated_disturbance

# Share of fits with a false alarm about feedback, and about colored prediction errors.
FALSE_ALARMS = 0.01


def in_time(pairs: Pairs, *, corrected: bool) -> tuple[Pairs, int]:
    """Return the pairs in time whose states are corrected, or not, and their number of outputs."""
    chosen = [
        (part, fitted)
        for part, fitted in pairs
        if fitted.data.has_time and part.model.criterion.corrects_states == corrected
    ]
    return chosen, sum(len(fitted.outputs) for _, fitted in chosen)


def by_piece(fitted: FittedRecord, values: Array) -> list[Array]:
    """Return values (n,) split at gaps: lags across one would compare samples far apart."""
    return [values[rows] for rows in fitted.data.independent_pieces]


def place_of(fitted: FittedRecord, pairs: Pairs) -> str:
    """Return which record is meant; nothing where there is only one."""
    return "" if len(pairs) == 1 else f" in {fitted.name!r}"


def gust_criterion(evidence: Evidence, part: RecordPart) -> str:
    """Return the code of the criterion that estimates gusts, for the states that they reach.

    A model that has gusts already keeps them.
    """
    model = part.problem.model
    stated = dict[str, Any]()
    if isinstance(model, ColoredDisturbance):
        stated = {s: stated_disturbance(color) for s, color in model.disturbances.items()}
    if part.system.states:
        stated.setdefault(disturbed_state(part, evidence.trajectory(part)), "colored")
    if not stated:  # delays alone
        return "PredictionError()"
    return f"PredictionError(disturbance={stated})"
