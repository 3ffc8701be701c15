"""The kinds of data that a problem takes: a new one is one more line of this table."""

from typing import Any

from greybox.modeling.formulation.data_kind import DataKind
from greybox.modeling.formulation.record_kind import RecordKind
from greybox.modeling.formulation.response_kind import ResponseKind
from greybox.modeling.formulation.spectrum_kind import SpectrumKind
from greybox.modeling.formulation.unsupported_data import described

DATA_KINDS: tuple[DataKind, ...] = (ResponseKind(), RecordKind(), SpectrumKind())


def kind_of(data: Any) -> DataKind:
    """Return the kind of the data.

    Raises
    ------
    TypeError
        If no kind has them, with what to give instead.
    """
    for kind in DATA_KINDS:
        if isinstance(data, kind.data_class):
            return kind
    raise TypeError(f"data is {described(data)}.")
