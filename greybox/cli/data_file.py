"""A file given with --data: a frequency response, the spectrum of a manoeuvre, or a table with a model's signals."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record, Recording
from greybox.data.response_columns import OMEGA, RECTANGULAR
from greybox.data.response_file import read_response
from greybox.data.transient_file import claims_spectrum, read_spectrum
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.data.units import to_si
from greybox.files.delimited_text import read_delimited
from greybox.files.heading import heading
from greybox.files.safe_files import require_file
from greybox.formulation.signal_units import as_the_only_pair
from greybox.logs.readers import read
from greybox.logs.readers.table_columns import seconds
from greybox.modeling.model import Model

LONG = 200  # characters of a list in a sentence: more would hide the cure after it


def read_data(
    path: str | Path,
    model: Model,
    input: str = "",
    output: str = "",
    columns: Mapping[str, str] | None = None,
) -> FrequencyResponse | Record | TransientSpectrum:
    """Return a response, the spectrum of a manoeuvre, or else the one record of the file with the model's signals.

    `columns` are as `--columns` states them: those of a response if one is its frequency or
    magnitude.

    Raises
    ------
    ValueError, FileNotFoundError
        If there is no such file, or it has neither or several such records, or its units are not
        SI.
    """
    path = Path(path)
    require_file(path)
    if not columns and claims_spectrum(path):
        return read_spectrum(path)
    if {"frequency", "magnitude"} & columns.keys() if columns else _is_response(path):
        return as_the_only_pair(
            model, read_response(path, input=input, output=output, columns=columns)
        )
    try:
        log = read(path, columns=columns or None)
    except ValueError as error:
        if columns:
            raise
        raise ValueError(
            f"{path} is neither a frequency response, with columns {', '.join((OMEGA, *RECTANGULAR))}, nor a record: {error}"
        ) from None
    return _record_of(log, path, model)


def _is_response(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(4096)
    if b"\0" in head:
        return False
    names = read_delimited(path, head).header
    if OMEGA in names or not names:
        return True
    timed = any(
        seconds(*heading(name)) for name in names
    )  # alpha and beta are also angles of a flight
    return not timed and any(
        name.endswith(column) for name in names for column in (OMEGA, *RECTANGULAR)
    )


def _record_of(log: Recording, path: Path, model: Model) -> Record:
    inputs, outputs = model.input_names, model.output_names
    fitting = [
        r for r in log.values() if set(inputs) <= set(r.signals) and set(outputs) & set(r.signals)
    ]
    if len(fitting) != 1:
        there = "; ".join(f"{name}: {', '.join(record.signals)}" for name, record in log.items())
        raise ValueError(
            f"{path} has {len(fitting) or 'no'} {'messages' if fitting else 'message'} with the signals of "
            f"{model.label} ({', '.join((*inputs, ' or '.join(outputs)))}); it has {there:.{LONG}}: "
            f"{_naming(inputs, outputs) if len(log) == 1 else _preparation(path, (*inputs, *outputs))}."
        )
    (record,) = fitting
    findings = list(record.findings)
    names = (*inputs, *outputs)
    for name in names:
        try:
            conversion = to_si(record.units.get(name, ""))
        except ValueError as error:
            findings.append(f"{name} was taken as it is, in {record.units[name]!r}: {error}.")
            continue
        if conversion.changes:
            raise ValueError(
                f"{path} has {name} in {record.units[name]}, but a fit needs {conversion.si}: "
                + (
                    f"{_converting(record, names)}."
                    if len(log) == 1
                    else f"{_preparation(path, names)}."
                )
            )
    # What the log says of other messages is left out.
    findings += [
        text
        for text in log.findings
        if text not in findings and text.partition(":")[0] not in log.records
    ]
    return replace(record, findings=tuple(findings))


def _naming(inputs: Sequence[str], outputs: Sequence[str]) -> str:
    signals = " ".join(f"{name}=COLUMN" for name in (*inputs, *outputs))
    return (
        f"say which columns they are, with units that become SI, --columns time=COLUMN:ms {signals}; of a frequency "
        "response --columns frequency=COLUMN:Hz magnitude=COLUMN:dB phase=COLUMN:deg"
    )


def _converting(record: Record, names: Sequence[str]) -> str:
    return f"--columns {' '.join(f'{name}={name}' for name in names if name in record.signals)} converts it"


def _preparation(path: Path, names: Sequence[str]) -> str:
    fields = ", ".join(f"{name!r}: 'MESSAGE.Field'" for name in names)
    return (
        f"make the record with gb.prepare(gb.read({str(path)!r}), {{{fields}}}); for the command line do so in a file "
        "my.py with a function problem() that returns gb.Problem(model, record)"
    )
