"""One model for several records: shared parameters are one unknown, those of a record's own get its number."""

from collections.abc import Sequence
from typing import Any

from greybox.data.record import Record
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.model import Model, require_known


def several(
    model: Model, records: Sequence[Record], own: Sequence[str] = (), **options: Any
) -> Sum[Problem]:
    """Return the sum of a problem for every record, parameters shared but for those of its own.

    Every record has its own estimated noise variances, which weight it: a record that the model
    fits badly has little weight. To give records of one sensor equal weight, state its standard
    deviation, ``criterion=OutputError(noise={"y": 0.1})``; with a single output any value will do,
    since standard errors use the residual variance. One record that holds all of them, with gaps in
    its time, has one estimated variance.

    Parameters
    ----------
    model : Model
    records : sequence of Record
        Of any lengths and rates; initial states are each record's own.
    own : sequence of str
        Parameters that each record has for itself, named ``<name>_1``, ``<name>_2`` ...; the biases
        of the criterion are so anyway, as in every sum, unless `rename` gives them one name.
    options
        Of every `Problem`: criterion, fixed, tied, constraints ...

    Raises
    ------
    ValueError
        For a name that is not a parameter, or fewer than two records.
    """
    if not isinstance(records, Sequence) or len(records) < 2:
        raise ValueError(
            "several() takes a list of at least two records: for one, use Problem(model, record)."
        )
    own = (own,) if isinstance(own, str) else tuple(own)

    parts = []
    for number, record in enumerate(records, start=1):
        problem = Problem(model, record, **options)
        require_known(own, problem.declared, "parameter", model.label)
        numbered = {name: f"{name}_{number}" for name in own}
        parts.append(problem.with_(rename={**problem.rename, **numbered}))
    return Sum(tuple(parts))
