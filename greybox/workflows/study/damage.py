"""What is damaged in a study, or was not made by this user.

The next process that writes removes what is damaged, and computes it again.
"""

import sqlite3
from pathlib import Path

from greybox.data.files.control_characters import printable
from greybox.data.files.wording import counted, listed
from greybox.workflows.study.database import (
    ANSWER,
    DATABASE,
    MARK_ANSWERS,
    RUN,
    TABLES,
    DamagedStudyError,
    ends_with_a_name,
    has_write_ahead_log,
    is_damage,
    is_ours,
    is_study,
    journal_of,
    opened,
    reading,
    require_safe,
    require_tree,
    tables_of,
    writing,
)

# Rows with wrong checksums.
DAMAGED_RUNS = (
    "runs LEFT JOIN members ON id = member WHERE name IS NULL OR "
    f"ifnull(runs.checksum, -1) != crc32({RUN}, runs.mark)"
)
DAMAGED_ANSWERS = (
    f"members WHERE answer IS NOT NULL AND ifnull(checksum, -1) != crc32({ANSWER}, mark)"
)

# The words for them, and the statement that removes them.
DAMAGES = {
    "damaged run": (
        DAMAGED_RUNS,
        f"DELETE FROM runs WHERE rowid IN (SELECT runs.rowid FROM {DAMAGED_RUNS})",
    ),
    "damaged answer": (
        DAMAGED_ANSWERS,
        f"UPDATE members SET answer = NULL WHERE id IN (SELECT id FROM {DAMAGED_ANSWERS})",
    ),
}

# Gives all runs the mark of this user, as `MARK_ANSWERS` does for answers.
MARK_RUNS = (
    f"UPDATE runs SET (checksum, mark) = (SELECT crc32({RUN}, mark), mark FROM (SELECT *, "
    f"mark({RUN}) AS mark FROM (SELECT name, fingerprint FROM members WHERE id = member)))"
)

# Whole rows without the mark of this user.
UNMARKED = {
    "run": "SELECT COUNT(*) FROM runs JOIN members ON id = member "
    f"WHERE runs.checksum = crc32({RUN}, runs.mark) AND runs.mark IS NOT mark({RUN})",
    "answer": "SELECT COUNT(*) FROM members WHERE answer IS NOT NULL "
    f"AND checksum = crc32({ANSWER}, mark) AND mark IS NOT mark({ANSWER})",
}


def require_own(folder: Path) -> None:
    """Raise ValueError for a study with runs or answers that this user has not made."""
    if not is_study(folder) or has_write_ahead_log(folder / DATABASE):
        return
    try:
        with reading(folder) as database:
            require_tree(folder, database)
            rows = [(what, database.execute(query).fetchone()) for what, query in UNMARKED.items()]
    except DamagedStudyError:
        return  # `mend` sets it aside
    foreign = [counted(count, what) for what, (count,) in rows if count]
    if foreign:
        raise ValueError(
            f"{folder} has {listed(foreign)} that were not made here by you: give another folder, "
            "or trust=True if you vouch for whoever made them."
        )


def mend(folder: Path, *, trust: bool = False) -> list[str]:
    """Remove what is damaged in a study that is locked, and return it as texts.

    A database that SQLite finds damaged is renamed. In others, runs and answers with wrong
    checksums are deleted. With `trust`, the others get the mark of this user.
    """
    if not is_study(folder):
        return []
    damage: list[str] = []
    path = folder / DATABASE
    if not _is_sound(path):
        damaged = path.with_suffix(".damaged")
        path.replace(damaged)
        # SQLite would apply the journal of the damaged database to the new one.
        journal_of(path).unlink(missing_ok=True)
        return [f"the database was damaged and is kept as {damaged.name}"]

    with writing(folder) as database:
        for what, (rows, cure) in DAMAGES.items():
            counts = database.execute(f"SELECT name, COUNT(*) FROM {rows} GROUP BY name")
            damage += [f"{name}: removed {counted(count, what)}" for name, count in counts]
            database.execute(cure)
        for statement in (MARK_RUNS, MARK_ANSWERS) if trust else ():
            database.execute(statement)
    return [*map(printable, damage)]


def _is_sound(path: Path) -> bool:
    """Return whether SQLite can read all of a database, and all tables of a study are there."""
    if has_write_ahead_log(path):
        return False
    require_safe(path)
    if ends_with_a_name(journal_of(path)):
        return True  # whoever writes refuses it
    try:
        with opened(path) as database:
            whole = database.execute("PRAGMA integrity_check(1)").fetchone() == ("ok",)
            # Others belong to another program, or to a later version: they are refused, not mended.
            return whole and (not is_ours(database) or tables_of(database) == TABLES[:2])
    except sqlite3.Error as error:
        return not is_damage(error)
