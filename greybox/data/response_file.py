"""Frequency responses in files: CSV and HDF5."""

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from greybox.data.frequency_response import FrequencyResponse, Stretch
from greybox.data.response_columns import COMMON, EXTRAS, Column, assembled, extras, stated_columns
from greybox.files.delimited_text import DecimalMark, read_delimited
from greybox.files.safe_files import require_file, write_text
from greybox.files.text_table import counted

COLUMNS = ("omega_rad_s", "alpha", "beta", *EXTRAS)
OWN_UNITS = {"frequency": "rad/s"}
KIND = "frequency response"
HDF5 = (".h5", ".hdf5")
HEADER = re.compile(
    r"#\s*(?P<key>[^:]+?)\s*:\s*(?P<value>.*?)\s*"
)  # a comment line of a CSV file: a key and its value
UNIT = "unit of "  # begins the key of a unit
NAMES = ("input", "output", "name", "source")
STRETCH = "# stretch"  # begins a comment line of a CSV file: checksum, start and end
Node = Any


def read_response(
    path: str | Path,
    prefix: str = "",
    input: str = "",
    output: str = "",
    name: str = "",
    *,
    columns: Mapping[str, str] | None = None,
) -> FrequencyResponse:
    """Read a `FrequencyResponse` from a CSV file, or from an HDF5 file that `write_response` wrote.

    The columns of a CSV file are ``omega_rad_s`` and those of `FrequencyResponse.columns`; their
    order and further columns do not matter. A table of several responses names them
    ``<prefix>alpha`` and so on, with one common ``omega_rad_s``; rows in which the chosen response
    is blank are left out. `input` and `output` choose one of a matrix that `write_responses` wrote.
    Tables with other columns are read with ``columns={"frequency": "f:Hz", "magnitude": "mag:dB",
    "phase": "ph:deg", "coherence": "coh"}``: the name of each in the header and, unless it stands
    there, its unit; ``alpha`` and ``beta`` may stand for magnitude and phase, rad/s, rad and
    ``absolute`` for the units. Cells are separated by commas, semicolons or tabs, numbers may have
    decimal commas, and lines that start with ``#`` or ``%`` are comments.

    Raises
    ------
    ValueError
        If the HDF5 file is damaged or something else; or a column of the CSV file is missing, a
        line has more cells than the header, or a cell is not a number, or might be two. The
        sentence names file, line and cell.
    FileNotFoundError
        If there is no such file.
    """
    path = Path(path)
    require_file(path)
    if path.suffix.lower() in HDF5:
        return _read_hdf5(path, input, output, name)

    raw = path.read_bytes()
    stated = {} if prefix else comments(raw)
    table = read_delimited(path, raw)
    header = table.header
    if f"{output}_{input}_alpha" in header and "alpha" not in header:
        prefix = prefix or f"{output}_{input}_"
    try:
        found = stated_columns(columns, header) if columns else _own_columns(header, prefix)
    except ValueError as error:
        raise ValueError(f"{path} {error}") from None
    wanted = {role: column.place for role, column in found.items()}

    rows = [
        (number, _wanted_cells(path, number, row, wanted, len(header)))
        for number, row in table.rows()
    ]
    rows = [
        (number, cells)
        for number, cells in rows
        if any(cells[c] for c in cells if c != "frequency")
    ]
    mark = DecimalMark(path, ((number, cells.values()) for number, cells in rows))
    labels = {role: header[place] for role, place in wanted.items()}
    numbers = [_numbers(path, number, cells, mark, labels) for number, cells in rows]
    kept = np.array(numbers, dtype=float).reshape(-1, len(wanted))
    values = dict(zip(wanted, kept.T, strict=True))
    texts = _texts(stated, input=input, output=output, name=name or path.stem, source=path.name)
    try:
        return assembled(values, found, **texts, stretches=stretches_in(raw))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _own_columns(header: Sequence[str], prefix: str) -> dict[str, Column]:
    """Return the columns of a file as `write_response` writes it.

    Raises
    ------
    ValueError
        If one is missing or there twice.
    """
    names = {name: _column(name, prefix) for name in COLUMNS}
    missing = [names[name] for name in COLUMNS[:3] if names[name] not in header]
    pairs = [name.removesuffix("_alpha") for name in header if name.endswith("_alpha")]
    if missing and pairs and not prefix:
        raise ValueError(
            f"holds several responses, {', '.join(pairs)}: choose one by the names of its input and output."
        )
    if missing:
        raise ValueError(
            f"has no column {missing[0]!r}; it has {', '.join(header) or 'no header line'}: the columns must be "
            "omega_rad_s, alpha, beta and, if known, coherence, variance, dof, or be named, columns={...}."
        )
    twice = [name for name in names.values() if header.count(name) > 1]
    if twice:
        raise ValueError(f"has two columns {twice[0]!r}: rename or remove one.")
    common = {name.removeprefix(prefix): name for name in header if name.startswith(prefix)}
    common = {role: name for role, name in common.items() if COMMON.fullmatch(role)}
    roles = {
        "frequency": names["omega_rad_s"],
        **{name: names[name] for name in COLUMNS[1:]},
        **common,
    }
    return {
        role: Column(header.index(name), OWN_UNITS.get(role, ""))
        for role, name in roles.items()
        if name in header
    }


def write_response(response: FrequencyResponse, path: str | Path) -> None:
    """Write `response` to a CSV or, by the suffix .h5 or .hdf5, an HDF5 file that `read_response` reads back exactly.

    CSV holds the numbers; before them, in comments ``# key: value``, the names and units of the
    signals and what the response says about itself; after them the stretches of records that they
    come from. HDF5 also has the names of response and source, and a checksum (see
    `greybox.files.sealed_files`): attributes ``input, output, name, source`` and datasets
    ``omega``, those of `FrequencyResponse.columns`, ``stretches`` (a text for each: checksum, start
    and end) and ``about`` (texts ``key: value``).
    """
    path = Path(path)
    if path.suffix.lower() in HDF5:
        from greybox.files.sealed_files import write_sealed  # noqa: PLC0415  (h5py is imported when it is needed)

        write_sealed(path, KIND, lambda file: write_group(file, response))
        return
    columns = {"omega_rad_s": response.omega, **response.columns}
    rows = zip(*columns.values(), strict=True)
    stated = {
        name: text for name in ("input", "output") if (text := getattr(response, name))
    } | _described(response)
    lines = [f"# {key}: {text}" for key, text in stated.items()]
    lines += [",".join(columns), *(",".join(repr(float(v)) for v in row) for row in rows)]
    lines += [f"{STRETCH} {stretch_line(s)}" for s in response.stretches]
    write_text(path, "\n".join(lines) + "\n")


def write_responses(responses: Sequence[FrequencyResponse], path: str | Path) -> None:
    """Write several responses, as the matrix of a plant, into one CSV file with one common ``omega_rad_s``.

    The columns of a response are ``<output>_<input>_alpha`` and so on, blank at the frequencies of
    others; it is read back by ``read_response(path, input=input, output=output)``.

    Raises
    ------
    ValueError
        If the file is no CSV, or two responses are of one pair.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise ValueError(
            f"{path} is not a table: several responses are kept in one file that ends in .csv."
        )
    table: dict[float, dict[str, str]] = {}
    columns: list[str] = []
    for response in responses:
        prefix = f"{response.output}_{response.input}_"
        if f"{prefix}alpha" in columns:
            raise ValueError(
                f"two responses are of {response.output} to {response.input}: keep one of them."
            )
        known = response.columns
        columns += [prefix + name for name in known]
        for k, omega in enumerate(response.omega.tolist()):
            table.setdefault(omega, {}).update(
                {prefix + name: repr(float(x[k])) for name, x in known.items()}
            )
    lines = [",".join([COLUMNS[0], *columns])]
    lines += [
        ",".join([repr(w), *(table[w].get(name, "") for name in columns)]) for w in sorted(table)
    ]
    write_text(path, "\n".join(lines) + "\n")


def write_group(group: Node, response: FrequencyResponse) -> None:
    """Write `response` into an HDF5 group."""
    for name in NAMES:
        group.attrs[name] = getattr(response, name)
    lines = {
        "stretches": [stretch_line(s) for s in response.stretches],
        "about": [f"{key}: {text}" for key, text in _described(response).items()],
    }
    for name, texts in lines.items():
        if texts:
            import h5py  # noqa: PLC0415  (reading does not need it)

            group.create_dataset(name, data=texts, dtype=h5py.string_dtype())
    for column, values in {"omega": response.omega, **response.columns}.items():
        group[column] = values


def read_group(group: Node) -> FrequencyResponse:
    """Read a `FrequencyResponse` from an HDF5 group."""
    known = {
        name: item[()] for name, item in group.items() if name in EXTRAS or COMMON.fullmatch(name)
    }
    lines = list(group["about"][()]) if "about" in group else []
    stated = {
        match["key"]: match["value"] for line in lines if (match := HEADER.fullmatch(f"# {line}"))
    }
    texts = _texts(stated, **{name: str(group.attrs[name]) for name in NAMES})
    stretches = (
        [stretch_from(line) for line in group["stretches"][()]] if "stretches" in group else []
    )
    response = group["alpha"][()] + 1j * group["beta"][()]
    return FrequencyResponse(
        group["omega"][()], response, **texts, **extras(known), stretches=stretches
    )


def _read_hdf5(path: Path, input: str, output: str, name: str) -> FrequencyResponse:
    from greybox.files.sealed_files import open_sealed  # noqa: PLC0415  (h5py is imported when it is needed)

    with open_sealed(path, KIND) as file:
        response = read_group(file)
    return replace(
        response,
        input=input or response.input,
        output=output or response.output,
        name=name or response.name,
    )


def _described(response: FrequencyResponse) -> dict[str, str]:
    """Return units and what is said about a response, by the keys that stand in its file."""
    units = {f"{UNIT}{name}": unit for name, unit in response.units.items() if unit}
    return units | {key: text for key, text in response.about.items() if key not in NAMES}


def comments(raw: bytes) -> dict[str, str]:
    """Return the comments ``# key: value`` that stand before the numbers of a CSV file."""
    stated = {}
    for line in raw.decode("utf-8-sig", "replace").splitlines():
        if line.strip() and not line.startswith(("#", "%")):
            break
        match = HEADER.fullmatch(line)
        if match:
            stated[match["key"]] = match["value"]
    return stated


def _texts(stated: dict[str, str], **names: str) -> dict[str, Any]:
    """Return names, units and the rest of what a file states; names that are given go before those in the file."""
    units = {key.removeprefix(UNIT): text for key, text in stated.items() if key.startswith(UNIT)}
    about = {
        key: text for key, text in stated.items() if not key.startswith(UNIT) and key not in NAMES
    }
    return {name: given or stated.get(name, "") for name, given in names.items()} | {
        "units": units,
        "about": about,
    }


def stretch_line(stretch: Stretch) -> str:
    """Return a stretch as files have it."""
    return f"{stretch.checksum} {stretch.start!r} {stretch.end!r}"


def stretch_from(line: str) -> Stretch:
    """Return the stretch that stands in a line."""
    checksum, start, end = line.rsplit(maxsplit=2)
    return Stretch(checksum.strip(), float(start), float(end))


def stretches_in(raw: bytes) -> list[Stretch]:
    """Return the stretches that comments of a CSV file state; comments that only begin like them state none."""
    found = []
    for line in raw.decode("utf-8", "replace").splitlines():
        if line.startswith(f"{STRETCH} "):
            with contextlib.suppress(ValueError):
                found.append(stretch_from(line.removeprefix(STRETCH)))
    return found


def _column(name: str, prefix: str) -> str:
    return name if name == "omega_rad_s" else prefix + name


def _wanted_cells(
    path: Path, line: int, row: list[str], wanted: dict[str, int], width: int
) -> dict[str, str]:
    if len(row) < max(wanted.values()) + 1:
        raise ValueError(
            f"{path}, line {line}, has {counted(len(row), 'cell')} where the header has {width}."
        )
    return {name: row[k] for name, k in wanted.items()}


def _numbers(
    path: Path, line: int, cells: dict[str, str], mark: DecimalMark, labels: Mapping[str, str]
) -> list[float]:
    """Return the cells of one line as numbers; `labels` are the names of their columns in the file."""
    numbers = []
    for name, cell in cells.items():
        try:
            numbers.append(mark.number(cell))
        except ValueError:
            raise ValueError(
                f"{path}, line {line}: {labels[name]} is {cell!r}, which is not a number."
            ) from None
    return numbers
