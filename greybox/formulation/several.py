"""One model for several records, with shared parameters and parameters of each record."""

from collections.abc import Sequence
from typing import Any

from greybox.data.record import Record
from greybox.files.argument_checks import as_names
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.model import Model, require_known


def several(
    model: Model, records: Sequence[Record], own: Sequence[str] = (), **options: Any
) -> Sum[Problem]:
    """Return the sum of a problem for every record; all parameters but `own` are shared.

    Every record is weighted by its own estimated noise variances: a record that the model fits
    badly has little weight. To give records of one sensor equal weight, give its standard
    deviation, ``criterion=OutputError(noise={"y": 0.1})``; for a single output any value will do,
    since the standard errors use the residual variance. Or join the records to one record with gaps
    in its time, and ``gaps="cut"``.

    Parameters
    ----------
    model : Model
    records : sequence of Record
        They may have different lengths and rates; every record has its own initial states.
    own : sequence of str
        Parameters of each record, named ``<name>_1``, ``<name>_2`` ...; the biases of the criterion
        are always such, unless `rename` gives them one name.
    options
        Options of every `Problem`: criterion, fixed, tied, constraints ...

    Raises
    ------
    ValueError
        For a name that is not a parameter, or fewer than two records.

    Examples
    --------
    >>> from greybox.models.specific_force import BodyDrag
    >>> from greybox.problems import nanobench_drag
    >>> criterion = gb.OutputError(biases=("a_x", "a_y"))  # offsets of each flight
    >>> both = gb.several(BodyDrag(), nanobench_drag.data(), criterion=criterion)
    >>> len(both.parts)
    2
    """
    if not isinstance(records, Sequence) or len(records) < 2:
        raise ValueError(
            "several() takes a list of at least two records: for one, use Problem(model, record)."
        )

    own = as_names(own)

    parts = []
    for number, record in enumerate(records, start=1):
        # Each record has its own problem, so that its noise and its initial states are its own.
        problem = Problem(model, record, **options)
        require_known(own, problem.declared, "parameter", model.label)
        numbered = {name: f"{name}_{number}" for name in own}
        parts.append(problem.with_(rename={**problem.rename, **numbered}))

    return Sum(tuple(parts))
