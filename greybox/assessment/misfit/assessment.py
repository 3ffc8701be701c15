"""The test of a fit: whether its residuals follow terms that the model does not have."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.assessment.misfit.answer import NAMED, Cause, Misfit
from greybox.assessment.misfit.causes.included import CAUSES, RecordCause
from greybox.assessment.misfit.group import group_of
from greybox.assessment.misfit.group_misfit import determined_values, misfit_of_group
from greybox.assessment.misfit.manoeuvre_regression import regression_of_manoeuvre
from greybox.assessment.misfit.record_regression import regression_of_record
from greybox.assessment.misfit.regression import Regression
from greybox.assessment.misfit.response_regression import is_held, regression_of_response
from greybox.assessment.misfit.shortened_record import shortened
from greybox.assessment.misfit.tested_record import TestedRecord
from greybox.data.files.arrays import Array
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.compiled.transient_part import TransientPart
from greybox.engine.covariance.active_limits import active_constraints
from greybox.modeling.added_terms import Formula
from greybox.statistics.column_space import open_directions

# Samples of all outputs of all records together, and at least of each record: a fit would wait for
# the test of more.
MOST, FEWEST = 6000, 500


def assessed_misfit(
    nlp: CompiledProblem,
    x: Array,
    trajectories: Sequence[Trajectory],
    at_bound: Sequence[str],
    candidates: Mapping[str, Formula],
    causes: Sequence[RecordCause] = CAUSES,
) -> Misfit | None:
    """Return whether a model explains its data at `x` (p,); None where that cannot be decided.

    Parameters that a bound holds, `at_bound`, absorb nothing. `candidates` has terms of the user,
    and `causes` yield the terms that are tried for records.
    """
    values, bounded = nlp.all_values(x), np.flatnonzero(np.isin(nlp.free, at_bound))
    # Directions in which the fit can move.
    free = open_directions(active_constraints(nlp, x)[0], bounded)
    responses = [
        regression_of_response(part, values, nlp.names, free) for part in nlp.parts_of(ResponsePart)
    ]
    manoeuvres = [
        regression_of_manoeuvre(part, trajectory, values, nlp.names, free)
        for part, trajectory in nlp.rows_of(TransientPart, trajectories)
    ]
    held = [nlp.free[k] for k in np.flatnonzero(is_held(free))]
    flights = _flights(nlp, trajectories, held, candidates)
    # Records are linearized by the solver's variables, responses by the parameters.
    by_x = free.T * nlp.scaling.slope(x)
    records = []
    for flight in flights:
        terms = [term for cause in causes for term in cause(flight)]
        records.append(regression_of_record(flight, terms, by_x, len(flights)))

    return _of_all([responses, manoeuvres, records])


def _of_all(kinds: Sequence[Sequence[Regression]]) -> Misfit | None:
    """Return the misfit of responses, manoeuvres and records together."""
    groups = [group_of(parts) for parts in kinds if any(part.terms for part in parts)]
    misfits = [
        misfit_of_group(group, determined)
        for group, determined in zip(groups, determined_values(groups), strict=True)
    ]
    if all(misfit.explains and not misfit.tried for misfit in misfits):
        return None

    # Of terms with equal texts, the best is reported.
    best = dict[str, Cause]()
    for misfit in misfits:
        for cause in misfit.causes:
            best.setdefault(cause.text, cause)

    worst = max(misfits, key=lambda misfit: (not misfit.is_exact, misfit.left - misfit.noise))
    return replace(
        worst,
        tried=sum(misfit.tried for misfit in misfits),
        causes=tuple(sorted(best.values(), key=_place)),
        p_common=min(misfit.p_common for misfit in misfits),
        shape=misfits[-1].shape,
        level=misfits[-1].level,
    )


def _place(cause: Cause) -> tuple[bool, bool, float]:
    """Return the place of a cause: what explains most, among what is significant, comes first.

    Among these, what has no known form comes last.
    """
    # Rounding must not order what explains as much.
    return cause.p_value >= NAMED, not cause.code, -round(cause.share, 9)


def _flights(
    nlp: CompiledProblem,
    trajectories: Sequence[Trajectory],
    held: Sequence[str],
    candidates: Mapping[str, Formula],
) -> list[TestedRecord]:
    """Return the records, shortened if they are long."""
    rows = nlp.rows_of(RecordPart, trajectories)
    records = [(part, trajectory) for part, trajectory in rows if part.model.has_time]
    # A third of the samples of six outputs tells as much as all of two, but one at a rate of its
    # own has few numbers among them.
    outputs = sum(part.numbers / part.samples for part, _ in records)
    most = int(max(MOST / max(outputs, 2 * len(records), 1), FEWEST))
    flights: list[TestedRecord] = []
    for part, trajectory in records:
        record = shortened(part, trajectory, most)
        flights.append(TestedRecord(record, held, candidates, earlier=tuple(flights)))
    return flights
