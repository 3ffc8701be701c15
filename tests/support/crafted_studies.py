"""Folders of studies as a stranger could send them."""

import os
import signal
import sqlite3
import struct
import subprocess
import sys
import zlib
from contextlib import closing
from pathlib import Path

from greybox.workflows.study.database import DATABASE
from greybox.workflows.study.members import add_members
from greybox.workflows.study.stored_runs import StoredRuns

MAGIC = bytes.fromhex("d9d505f920a163d7")
SECTOR = 512


def plant_journal(folder, victim):
    """Write a journal that a process left when it was killed; it names a file that SQLite deletes.

    Its format is that of https://www.sqlite.org/fileformat2.html, section 3. It has no pages, so
    that the database stays as it is.
    """
    database = folder / DATABASE
    page = struct.unpack(">H", database.read_bytes()[16:18])[0]
    pages = database.stat().st_size // page
    head = MAGIC + struct.pack(">IIIII", 0, 1, pages, SECTOR, page)
    name = os.fsencode(victim)
    last = struct.pack(">II", len(name), sum(name) & 0xFFFFFFFF) + MAGIC
    record = struct.pack(">I", (1 << 30) // page + 1) + name + last
    (folder / f"{DATABASE}-journal").write_bytes(head.ljust(SECTOR, b"\0") + record)


def kill_in_transaction(folder, statement):
    """Change a database in a process that is killed before it commits, with pages on disk."""
    program = (
        "import os, signal, sqlite3, sys\n"
        "database = sqlite3.connect(sys.argv[1], isolation_level=None)\n"
        "database.execute('PRAGMA cache_size = 1')\n"
        "database.execute('PRAGMA cache_spill = 1')\n"
        "database.execute('BEGIN')\n"
        "database.execute(sys.argv[2])\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    command = [sys.executable, "-c", program, str(folder / DATABASE), statement]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    assert (folder / f"{DATABASE}-journal").stat().st_size > SECTOR


def contents(folder):
    """Return all files of a folder with their bytes."""
    return {
        path.relative_to(folder): path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.is_file() and not path.is_symlink()
    }


def study_of(folder, **answers):
    """Store a study with such answers, or none yet."""
    add_members(folder, list(answers))
    runs = StoredRuns(folder)
    for name, answer in answers.items():
        if answer is not None:
            runs.begin(name)
            runs.finish(answer)
    runs.write()


def put_answer(folder, packed):
    """Store bytes in place of an answer, with a right checksum."""
    with closing(sqlite3.connect(folder / DATABASE)) as database, database:
        rows = database.execute("SELECT id, name, fit, mark FROM members").fetchall()
        for number, name, fit, mark in rows:
            checksum = zlib.crc32(b"\n".join((packed, fit, name.encode(), mark)))
            statement = "UPDATE members SET answer = ?, checksum = ? WHERE id = ?"
            database.execute(statement, (packed, checksum, number))
