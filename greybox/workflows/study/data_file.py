"""A data file: a frequency response, or a record."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from greybox.data.clock import Gaps
from greybox.data.files.delimited_text import read_delimited
from greybox.data.files.escapes import in_sentences
from greybox.data.files.grouping import unique
from greybox.data.files.safe_files import require_file
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.headings import headings
from greybox.data.logs.prepare import prepare as prepared
from greybox.data.logs.readers import read
from greybox.data.record import Record, Recording
from greybox.data.response_columns import OMEGA, RECTANGULAR
from greybox.data.response_file import PAIR, read_response, read_responses
from greybox.data.time_column import seconds
from greybox.data.wrapped_angles import unwrapped
from greybox.modeling.formulation.signal_units import as_the_only_pair
from greybox.modeling.model import Model, require_known


class UnreadableError(ValueError):
    """A data file cannot be read, or lacks the signals of the model.

    In a member of a study it takes the place of the problem, which has no parts then.
    """

    parts = ()
    name = ""


@in_sentences
def read_data(
    path: str | Path,
    model: Model,
    input: str = "",
    output: str = "",
    *,
    columns: Mapping[str, str] | None = None,
    rate: float | None = None,
    prepare: Mapping[str, Any] | None = None,
    gaps: Gaps | Literal[""] = "",
) -> FrequencyResponse | tuple[FrequencyResponse, ...] | Record:
    """Return a response, or the only record with the model's signals.

    A table of several responses, see `read_responses`, gives all of them.

    `columns` name the columns of a table, with units: ``{"theta": "pitch:deg"}``. They are those of
    a response if they contain its frequency or magnitude. The `rate`, in Hz, is the sampling rate
    of a table without a time. `prepare` has the arguments of `gb.prepare`, for a log. `gaps` state
    what long steps of a record are, see `Record`.

    Raises
    ------
    ValueError, FileNotFoundError
        If the file does not exist, has no or several such records, or its columns do not exist.
    """
    path = require_file(path)
    options: dict[str, Any] = {"columns": columns, "rate": rate, "gaps": gaps or "auto"}
    if prepare:
        return prepared(read(path, **options), **prepare)
    # Only the beginning of a table has its header: a log may have gigabytes.
    with path.open("rb") as file:
        head = file.read(65536)
    names = None if b"\0" in head else read_delimited(path, head).header
    is_response = _is_response(names, columns or {})
    if rate and is_response:
        raise ValueError(f"rate={rate:g} is for a table of signals, and {path} is something else.")
    if gaps and is_response:
        raise ValueError(f"gaps={gaps} is for a table of signals, and {path} is something else.")
    name, value = ("input", input) if input else ("output", output)
    if value and not is_response:
        raise ValueError(
            f"{name}={value} is for a frequency response, and {path} is something else: leave it "
            "out."
        )
    if is_response and names is not None:
        has_pairs = len(model.input_names) * len(model.output_names) > 1
        matrix = not columns and any(name.endswith("_alpha") for name in names)
        if has_pairs and (matrix or {*PAIR} <= {*names}) and not (input or output):
            return read_responses(path, columns=columns)
        if f"{output}_{input}_alpha" not in names:
            require_known(filter(None, [input]), model.input_names, "input", model.label)
            require_known(filter(None, [output]), model.output_names, "output", model.label)
        return as_the_only_pair(
            model, read_response(path, input=input, output=output, columns=columns)
        )

    return record_of(read(path, **options), path, model)


def _is_response(names: tuple[str, ...] | None, columns: Mapping[str, str]) -> bool:
    if columns:
        return bool({"frequency", "magnitude"} & columns.keys())
    if names is None:
        return False
    if OMEGA in names:
        return True
    named = headings(names)
    # Alpha and beta are also the angles of attack and sideslip of a flight, which has a time.
    if any(seconds(*column) for column in named):
        return False
    are_roles = any(name.endswith((OMEGA, *RECTANGULAR)) for name in names)
    return are_roles or any(c.name.lower() == "magnitude" or c.unit == "dB" for c in named)


def record_of(log: Recording, path: Path, model: Model) -> Record:
    """Return the only record with the signals of the model, in SI units.

    Raises
    ------
    ValueError
        If there is no such record, or several.
    """
    inputs, outputs = model.input_names, model.output_names
    names = (*inputs, *outputs)
    records = [
        record
        for record in log.values()
        if set(inputs) <= set(record.signals) and set(outputs) & set(record.signals)
    ]
    if len(records) != 1:
        available = "; ".join(f"{key}: {', '.join(r.signals)}" for key, r in log.items())
        left_out = ""
        # A table can be described by options. A log has several messages with clocks of their own,
        # for which a record must be prepared.
        if len(log) == 1:
            left_out = "".join(f"; {finding:.200}" for finding in log.findings).rstrip(".")
            columns = " ".join(f"{name}=COLUMN" for name in names)
            cure = (
                f"name the columns, with units, columns=time=COLUMN:ms {columns}; or, if it is a "
                "response, columns=frequency=COLUMN:Hz magnitude=COLUMN:dB phase=COLUMN:deg"
            )
        else:
            fields = ", ".join(f"{name!r}: 'MESSAGE.Field'" for name in names)
            cure = (
                f"prepare the record with gb.prepare(gb.read({str(path)!r}), {{{fields}}}) in a "
                "file my.py whose function problem() returns gb.Problem(model, record)"
            )
        # More of a list would hide the cure after it.
        raise ValueError(
            f"{path} has {len(records) or 'no'} records with the signals of {model.label} "
            f"({', '.join((*inputs, ' or '.join(outputs)))}); it has "
            f"{available:.200}{left_out}. To fit it, {cure}."
        )

    (record,) = records
    # Models are written in SI units, tables in any.
    record = unwrapped(record.in_si(name for name in names if name in record.signals))
    return replace(record, findings=unique([*record.findings, *log.findings]))


def reading_once() -> Callable[..., Any]:
    """Return a function like `read_data` that reads a file once for all models of its signals.

    It raises UnreadableError, with the reason and the cure.
    """
    # A study of twelve models has each file in memory once.
    data: dict[str, Any] = {}

    def read(path: str, model: Model, **choices: Any) -> Any:
        key = repr((path, model.input_names, model.output_names, choices))
        try:
            if key not in data:
                data[key] = read_data(path, model, **choices)
        except (ValueError, LookupError, OSError) as error:
            raise UnreadableError(error.args[-1]) from error
        return data[key]

    return read
