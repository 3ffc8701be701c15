"""Writes and reads frequency responses as CSV files."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from greybox.data.files.delimited_text import DelimitedText, read_delimited, write_delimited
from greybox.data.files.escapes import in_sentences
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import without
from greybox.data.files.public import public
from greybox.data.files.safe_files import require_file
from greybox.data.frequency_response import FrequencyResponse, Stretch
from greybox.data.headings import headings, with_units_in_header
from greybox.data.response_columns import OMEGA, assembled, columns_by_role, written_columns

UNIT = "unit of "  # begins the key of a unit
STRETCH = "stretch "  # begins the key of a stretch
PAIRS = "pairs"  # key of the pairs of a matrix, output/input
PAIR = "output", "input"  # columns of a table whose rows name their responses
NAMES = ("input", "output", "name", "source", PAIRS)


@public
@in_sentences
def read_response(
    path: str | Path,
    prefix: str = "",
    input: str = "",
    output: str = "",
    name: str = "",
    *,
    columns: Mapping[str, str] | None = None,
) -> FrequencyResponse:
    """Read a `FrequencyResponse` from a CSV file.

    The columns are ``omega_rad_s`` and those of `FrequencyResponse.columns`, in any order; other
    columns are ignored. A table of several responses names them ``<prefix>alpha`` and so on, with
    one common ``omega_rad_s``; rows in which the chosen response is blank are left out. `input` and
    `output` choose one response of a matrix that `write_responses` wrote.

    Other tables are read with ``columns={"frequency": "f:Hz", "magnitude": "mag:dB", "phase":
    "ph:deg", "coherence": "coh"}``: the name of each column in the header and, unless the header
    has it, its unit. ``alpha`` and ``beta`` may replace magnitude and phase; other units are rad/s,
    rad and ``absolute``. Without a header line, the names of the columns are their numbers, from 1.

    Cells are separated by commas, semicolons or tabs, numbers may have decimal commas, and lines
    that start with ``#`` or ``%`` are comments. A line of units may stand below the header. The
    coherence may have the unit ``%``.

    Raises
    ------
    ValueError
        If a column is missing, a line has more cells than the header, or a cell is not a number or
        can be read as two. The message names file, line and cell.
    FileNotFoundError
        If there is no such file.

    Examples
    --------
    >>> omega = np.array([1.0, 2.0])
    >>> gb.data.write_response(gb.FrequencyResponse(omega, 1 / (1j * omega + 1)), "lag.csv")
    >>> abs(gb.read_response("lag.csv").response).round(3)
    array([0.707, 0.447])
    """
    path = require_file(path)
    table, names = _table(path)
    # The names of input and output choose a response of a matrix, and rename a single one.
    if f"{output}_{input}_alpha" in names and "alpha" not in names:
        prefix = prefix or f"{output}_{input}_"
    try:
        places = columns_by_role(columns or written_columns(table.header, prefix), table.header)
    except ValueError as error:
        raise ValueError(f"{path} {error}") from None

    # In a table of points of several responses, those of the chosen one.
    pair = {"output": output, "input": input} if output and {*PAIR} <= {*table.header} else {}
    values = table.numbers({role: column.place for role, column in places.items()}, pair)
    # The comments of a file describe its only response, not those of a matrix.
    facts = {} if prefix else table.facts
    try:
        return assembled(
            values,
            places,
            input=input or facts.get("input", ""),
            output=output or facts.get("output", ""),
            name=name or path.stem,
            source=path.name,
            **described(facts),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


@public
@in_sentences
def read_responses(
    path: str | Path, *, columns: Mapping[str, str] | None = None
) -> tuple[FrequencyResponse, ...]:
    """Read all responses of a matrix, in their order in the file.

    The table is one of `write_responses`. Or each row is a point of the response that its cells
    under ``output`` and ``input`` name, in addition to the columns that `read_response` takes.

    Raises
    ------
    ValueError, FileNotFoundError
        As `read_response`; also if there is no response, or if names of columns can be read as two
        pairs: those of signals with ``_`` need a comment ``# pairs: body_rate/stick ...``.
    """
    path = require_file(path)
    table, names = _table(path)
    prefixes = [name.removesuffix("_alpha") for name in names if name.endswith("_alpha")]
    stated = {pair.replace("/", "_"): pair for pair in table.facts.get(PAIRS, "").split()}
    pairs = [stated.get(prefix, prefix.replace("_", "/")).split("/") for prefix in prefixes]
    if {*PAIR} <= {*table.header}:
        o, i = map(table.header.index, PAIR)
        pairs = unique((*row[o : o + 1], *row[i : i + 1]) for _, row in table.rows())
    if not pairs or any(len(pair) != 2 for pair in pairs):
        raise ValueError(
            f"{path} has no columns OUTPUT_INPUT_alpha, or signals with '_' in their names: state "
            "the pairs in a comment, # pairs: output/input output/input; name the pair of every "
            "row in columns output and input; or read one response after the other, "
            "gb.read_response(..., input=..., output=..., columns=...)."
        )
    return tuple(
        read_response(path, input=i, output=o, name=f"{o}/{i}", columns=columns) for o, i in pairs
    )


def _table(path: Path) -> tuple[DelimitedText, list[str]]:
    """Return the table in a file, and the names of its columns without their units."""
    table = with_units_in_header(read_delimited(path, path.read_bytes()))
    return table, [column.name for column in headings(table.header)]


@public
def write_response(response: FrequencyResponse, path: str | Path) -> None:
    """Write `response` to a CSV file that `read_response` reads back exactly.

    Before the numbers, comments ``# key: value`` hold the names and units of the signals, what
    `FrequencyResponse.about` says, and the stretches of records from which it was estimated.
    """
    path = Path(path)
    require_csv(path)
    stretches = (f"{s.checksum} {s.start!r} {s.end!r}" for s in response.stretches)
    facts = {
        **{key: text for key in NAMES[:2] if (text := getattr(response, key))},
        **without(response.about, NAMES),
        **{f"{UNIT}{name}": unit for name, unit in response.units.items() if unit},
        **{f"{STRETCH}{k}": text for k, text in enumerate(stretches, start=1)},
    }
    columns = {key: x.tolist() for key, x in {OMEGA: response.omega, **response.columns}.items()}
    write_delimited(path, facts, columns)


@public
def write_responses(responses: Sequence[FrequencyResponse], path: str | Path) -> None:
    """Write several responses, as the matrix of a plant, to one CSV file with common frequencies.

    The columns of a response are ``<output>_<input>_alpha`` and so on, blank at the frequencies of
    others. `read_responses` reads them, ``read_response(path, input=input, output=output)`` one.

    Raises
    ------
    ValueError
        If the file is not CSV, or two responses are of one pair.
    """
    path = Path(path)
    require_csv(path)
    # Pairs may have been measured at different frequencies: cells of the others remain blank.
    omega = sorted({w for response in responses for w in response.omega.tolist()})
    columns = {OMEGA: [*omega]}
    pairs = " ".join(f"{response.output}/{response.input}" for response in responses)
    for response in responses:
        prefix = f"{response.output}_{response.input}_"
        if f"{prefix}alpha" in columns:
            raise ValueError(
                f"two responses are of {response.output} to {response.input}: keep one of them."
            )
        for name, x in response.columns.items():
            values = dict(zip(response.omega.tolist(), x.tolist(), strict=True))
            columns[prefix + name] = [values.get(w, "") for w in omega]
    write_delimited(path, {PAIRS: pairs}, columns)


def require_csv(path: Path) -> None:
    """Refuse a name that does not end in .csv: readers choose the format by it."""
    if path.suffix.lower() != ".csv":
        raise ValueError(f"{path} is not the name of a table: give one that ends in .csv.")


def described(facts: Mapping[str, str]) -> dict[str, Any]:
    """Return units, remarks and stretches from the facts of a file."""
    units, about, stretches = {}, {}, []
    for key, text in facts.items():
        if key.startswith(UNIT):
            units[key.removeprefix(UNIT)] = text
        elif key.startswith(STRETCH):
            # A comment that only begins like a stretch is ignored.
            with contextlib.suppress(ValueError):
                checksum, start, end = text.rsplit(maxsplit=2)
                stretches.append(Stretch(checksum, float(start), float(end)))
        elif key not in NAMES:
            about[key] = text

    return {"units": units, "about": about, "stretches": tuple(stretches)}
