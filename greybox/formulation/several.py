"""Several records of one model: what they share is one unknown, what is each one's own gets its number."""

from collections.abc import Sequence
from typing import Any

from greybox.data.record import Record
from greybox.formulation.problem import Problem, Sum
from greybox.modeling.model import Model, require_known


def several(model: Model, records: Sequence[Record], own: Sequence[str] = (), **options: Any) -> Sum:
    """Return the sum of a problem for every record, parameters shared but for those of its own.

    Parameters
    ----------
    model : Model
    records : sequence of Record
        Of any lengths and rates; initial states are each record's own.
    own : sequence of str
        Parameters that each record has for itself, named ``<name>_1``, ``<name>_2`` ...; the biases of the criterion
        are so anyway, as in every sum, unless `rename` gives them one name.
    options
        Of every `Problem`: criterion, fixed, tied, constraints ...

    Every record has its own estimated variances, by which it weighs: a record that the model fits badly weighs little.
    Records of one sensor weigh alike with given standard deviations, ``criterion=OutputError(noise={"y": 0.1})``, of a
    single output any: the standard errors follow the residuals. One record that holds them all, with gaps in its time
    between, has one estimated variance.

    Raises
    ------
    ValueError
        For a name that is not a parameter, or fewer than two records.
    """
    if not isinstance(records, Sequence) or len(records) < 2:
        raise ValueError("several() takes a list of at least two records: for one, use Problem(model, record).")
    own = (own,) if isinstance(own, str) else tuple(own)
    parts = []
    for k, record in enumerate(records, start=1):
        bare = Problem(model, record, **options)
        require_known(own, bare.declared, "parameter", model.label)
        parts.append(bare.with_(rename={**bare.rename, **{name: f"{name}_{k}" for name in own}}))
    return Sum(tuple(parts))
