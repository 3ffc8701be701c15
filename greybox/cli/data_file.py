"""The file given with --data: a frequency response, or a table with the signals of a model."""

from collections.abc import Sequence
from pathlib import Path

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record, Recording
from greybox.data.response_file import COLUMNS, HDF5, read_response
from greybox.logs.prepare import TO_SI
from greybox.logs.readers import read
from greybox.modeling.model import Model

LONG = 200  # characters of a list in a sentence: more would hide the cure after it


def read_data(path: str | Path, model: Model, input: str = "", output: str = "") -> FrequencyResponse | Record:
    """Return a frequency response, or else the one record of the file that has the signals of the model.

    Raises
    ------
    ValueError, FileNotFoundError
        If there is no such file, or it has neither or several such records, or its units are not SI.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}.")
    if _is_response(path):
        return read_response(path, input=input, output=output)
    try:
        log = read(path)
    except ValueError as error:
        raise ValueError(
            f"{path} is neither a frequency response, with columns {', '.join(COLUMNS[:3])}, nor a record: {error}"
        ) from None
    return _record_of(log, path, model)


def _is_response(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(4096)
    if path.suffix.lower() in HDF5:
        return head.startswith(b"greybox ")
    cells = head.decode("utf-8-sig", errors="replace").partition("\n")[0].split(",")
    names = [cell.strip() for cell in cells]
    return names == [""] or any(name.endswith(column) for name in names for column in COLUMNS[:3])


def _record_of(log: Recording, path: Path, model: Model) -> Record:
    inputs, outputs = model.input_names, model.output_names
    fitting = [r for r in log.values() if set(inputs) <= set(r.signals) and set(outputs) & set(r.signals)]
    if len(fitting) != 1:
        there = "; ".join(f"{name}: {', '.join(record.signals)}" for name, record in log.items())
        raise ValueError(
            f"{path} has {len(fitting) or 'no'} {'messages' if fitting else 'message'} with the signals of "
            f"{model.label} ({', '.join((*inputs, ' or '.join(outputs)))}); it has {there:.{LONG}}: "
            f"{_preparation(path, (*inputs, *outputs))}."
        )
    (record,) = fitting
    for name in (*inputs, *outputs):
        factor, unit = TO_SI.get(record.units.get(name, ""), (1.0, ""))
        if factor != 1:
            raise ValueError(
                f"{path} has {name} in {record.units[name]}, but a fit needs {unit}: "
                f"{_preparation(path, (*inputs, *outputs))}."
            )
    return record


def _preparation(path: Path, names: Sequence[str]) -> str:
    fields = ", ".join(f"{name!r}: 'MESSAGE.Field'" for name in names)
    return (
        f"make the record with gb.prepare(gb.read({str(path)!r}), {{{fields}}}); for the command line do so in a file "
        "my.py with a function problem() that returns gb.Problem(model, record)"
    )
