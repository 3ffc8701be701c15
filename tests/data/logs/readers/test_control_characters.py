"""Names and texts of a log are printed without what a terminal obeys."""

import json

import h5py
import numpy as np
import pytest
from synthetic_logs import Log

from greybox.cli.main import main
from greybox.data.logs.readers import read

ESCAPES = "\x1b]0:PWN\x07\x1b[2J\x1b[31m\x9b8m\u202e"


def dataflash(path):
    log = Log()
    log.fmt("MSG", "QZ", "TimeUS,Message", "s-", "F-")
    log.fmt("ATT", "Qff", "TimeUS,Roll,Pitch", "sdd", "F00")
    log.add("MSG", 1_000_000, "ArduCopter \x1b]0;PWN\x07\x1b[2J\x1b[31mX")
    for i in range(50):
        log.add("ATT", 1_000_000 + i * 10_000, 0.1, 0.2)
    path.write_bytes(log.binary)


def table(path):
    path.write_text(
        f"time [s],{ESCAPES}red [{ESCAPES}],text\n0,1,a\n1,2,b\n2,3,c\n", encoding="utf-8"
    )


def groups(path):
    with h5py.File(path, "w") as file:
        file[f"{ESCAPES}/time"] = np.arange(4.0)
        file[f"{ESCAPES}/x{ESCAPES}"] = np.arange(4.0)
        file[f"{ESCAPES}/x{ESCAPES}"].attrs["unit"] = ESCAPES
        file[f"{ESCAPES}/odd{ESCAPES}"] = np.arange(3.0)


@pytest.mark.parametrize(
    ("write", "name"), [(dataflash, "a.BIN"), (table, "a.csv"), (groups, "a.h5")]
)
def test_a_log(tmp_path, capsys, write, name):
    path = tmp_path / name
    write(path)
    recording = read(path)
    texts = [repr(recording), str(dict(recording.metadata)), *recording.findings, *recording]
    for record in recording.values():
        texts += [
            str(record),
            *record.signals,
            *record.units.values(),
            record.name,
            *record.findings,
        ]
    assert all(text.isprintable() for text in texts)

    for options in ([], ["--json"]):
        main(["inspect", str(path), *options])
        told = capsys.readouterr()
        assert (told.out + told.err).replace("\n", "").isprintable()
        if options:
            json.loads(told.out)


@pytest.mark.parametrize("text", [f"t;{ESCAPES}\n1;2;3\n", f"{ESCAPES}a{ESCAPES};b\n"])
def test_what_is_refused(tmp_path, text):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"a\.csv") as caught:
        read(tmp_path / "a.csv")
    assert str(caught.value).isprintable()


def test_the_name_of_a_file_that_came_by_mail(tmp_path, capsys):
    path = tmp_path / "\x1b[2J.csv"
    path.write_text("nothing")
    assert main(["inspect", str(path)]) == 2
    told = capsys.readouterr()
    assert told.err.rstrip("\n").isprintable()
    assert r"\x1b[2J.csv" in told.err
