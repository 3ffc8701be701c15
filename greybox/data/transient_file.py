"""Writes and reads the spectra of manoeuvres as CSV files."""

import json
from pathlib import Path

from greybox.data.response_columns import OMEGA, RECTANGULAR
from greybox.data.response_file import common_facts, described, require_csv
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.files.delimited_text import DelimitedText, read_delimited, write_delimited
from greybox.files.safe_files import require_file

KIND = "transient spectrum"
CHANGE = "change of "  # begins the key of the last less the first value of an input


def write_spectrum(spectrum: TransientSpectrum, path: str | Path) -> None:
    """Write a spectrum to a CSV file that `read_spectrum` reads back exactly.

    The file has the column ``omega_rad_s`` and, for every signal, ``<signal>_alpha`` and
    ``<signal>_beta``, the real and imaginary parts of its integral. Comments ``# key: value``
    before them hold everything else.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    path = Path(path)
    require_csv(path)
    # `repr` writes all digits of a number, so that the file is read back exactly.
    facts = {
        "kind": KIND,
        "name": spectrum.name,
        "source": spectrum.source,
        "duration": repr(float(spectrum.duration)),
        "step": repr(float(spectrum.step)),
        "inputs": json.dumps(list(spectrum.inputs), ensure_ascii=False),
        "outputs": json.dumps(list(spectrum.outputs), ensure_ascii=False),
        **{f"{CHANGE}{name}": repr(spectrum.change(name)) for name in spectrum.inputs},
        **common_facts(spectrum.units, [spectrum.stretch] if spectrum.stretch else []),
    }

    columns = {OMEGA: spectrum.omega.tolist()}
    for name, values in spectrum.signals.items():
        columns[f"{name}_{RECTANGULAR[0]}"] = values.real.tolist()
        columns[f"{name}_{RECTANGULAR[1]}"] = values.imag.tolist()
    write_delimited(path, facts, columns)


def read_spectrum(path: str | Path) -> TransientSpectrum:
    """Read a `TransientSpectrum` from a file that `write_spectrum` wrote.

    Raises
    ------
    ValueError
        If the file is damaged or of another kind.
    FileNotFoundError
        If there is no such file.
    """
    path = Path(path)
    require_file(path)
    table = read_delimited(path, path.read_bytes())
    if table.facts.get("kind") != KIND:
        raise ValueError(f"{path} is not a {KIND}: give a file that gb.data.write_spectrum wrote.")
    try:
        return _from_table(table)
    except (LookupError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is damaged: {error}") from None


def claims_spectrum(path: Path) -> bool:
    """Return whether a file claims to contain a spectrum."""
    # The kind is in the first comment, and a file may be large.
    with path.open("rb") as file:
        head = file.read(4096)
    return b"\0" not in head and read_delimited(path, head).facts.get("kind") == KIND


def _from_table(table: DelimitedText) -> TransientSpectrum:
    facts = table.facts
    columns = table.numbers({name: place for place, name in enumerate(table.header)})
    names = {kind: json.loads(facts[kind]) for kind in ("inputs", "outputs")}
    signals = {
        kind: {
            name: columns[f"{name}_{RECTANGULAR[0]}"] + 1j * columns[f"{name}_{RECTANGULAR[1]}"]
            for name in names[kind]
        }
        for kind in names
    }
    about = described(facts)

    return TransientSpectrum(
        columns[OMEGA],
        **signals,
        duration=float(facts["duration"]),
        step=float(facts["step"]),
        input_change={name: float(facts[f"{CHANGE}{name}"]) for name in names["inputs"]},
        units=about["units"],
        name=facts.get("name", ""),
        source=facts.get("source", ""),
        stretch=next(iter(about["stretches"]), None),
    )
