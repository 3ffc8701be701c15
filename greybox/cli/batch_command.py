"""The command `greybox batch`: many fits, stored in a folder as they are made."""

import argparse
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from greybox.cli.options import UsageError
from greybox.cli.output import Answer, save_figure
from greybox.cli.study_copies import copy_inputs, note_opened_files, stated_inputs
from greybox.cli.study_file import find_study, read_study_file
from greybox.cli.terminal import write
from greybox.cli.workers import stated_executor
from greybox.data.files.named_values import attributes
from greybox.data.files.safe_files import require_file
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import counted, some
from greybox.engine.solve.interruption import Interrupted
from greybox.engine.solve.lost_workers import ExecutorLostError
from greybox.workflows.study.batch import Member, batch
from greybox.workflows.study.damage import require_own
from greybox.workflows.study.database import DATABASE, is_study
from greybox.workflows.study.running import is_running
from greybox.workflows.study.study import Study, progress, read_study
from greybox.workflows.study.study_lock import locked

EXAMPLES = (
    "study.toml --out results --workers 2",
    "study.toml --out results --starts 400",
    "study.toml --dry-run",
    "paper --out paper",
    "--resume results",
    "--status results",
)
# The options that people use; the help shows the others below them.
USED = "--out --starts --seconds --workers --status --resume"
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = """
study STUDY
    study.toml, study.py with a function members(), or included: paper
--out DIR
    store every run, the answers and the files of the study in this folder; after any
    interruption the same command continues the study (required, except for a dry run)
--starts N
    number of starts of every member (default: the study's, or that of greybox fit); a larger
    number uses the stored runs again
--seconds S
    time limit of the study
--status
    print how far the study in the folder STUDY is and whether a process is working on it, and fit
    nothing
--plot FILE
    with --status: draw the costs so far
--resume
    continue the study in the folder STUDY, also on another machine, with the files that lie in it
--check
    remove damaged parts of the study in the folder STUDY, and list what is missing; run its
    command again to compute that
--dry-run
    print the members and their numbers of starts, and fit nothing
--trust
--workers
--scheduler
"""
RESUME = "`greybox batch --resume {}` continues"


def run(options: argparse.Namespace) -> Answer:
    """Run the batch, or continue it."""
    if options.status:
        study = read_study(options.study)
        running = is_running(study.folder)
        drawn = save_figure(options.plot, "estimates", study, "cost")
        answer = {**as_json(study), "running": running}
        return answer, "\n".join([progress(study), *_who_works(study, running=running), *drawn])
    folder = Path(options.study)
    if options.check:
        return _checked(folder, options.trust)
    folder = folder if options.resume else options.out
    # Before anything of the folder is run, or written into it.
    if not (options.trust or folder is None):
        require_own(folder)
    place, starts = options.study, None
    if options.resume:
        place, starts = stated_inputs(Path(options.study), trust=options.trust)
    note_opened_files()
    path, starts = find_study(place), options.starts or starts
    members = read_study_file(path, starts)
    if options.dry_run:
        return _listed(members)
    if folder is None:
        raise UsageError("the following arguments are required: --out; see greybox batch --help.")
    copy_inputs(path, folder, starts)
    _, _, *notes = _listed(members)
    write("\n".join(notes), sys.stderr)
    try:
        with stated_executor(options) as executor:
            study = batch(
                members, folder, executor=executor, seconds=options.seconds, trust=options.trust
            )
    except Interrupted as stopped:
        answer = {
            **as_json(stopped.study),
            "error": f"interrupted; {RESUME.format(quoted(folder))}.",
        }
        return answer, str(stopped.study)
    # Another process writes to the folder, or it is a file: the study has not failed.
    except (BlockingIOError, FileExistsError):
        raise
    # Lost workers or a full disk end the command, not the study: its stored runs remain.
    except (ExecutorLostError, OSError) as error:
        return ({"error": f"{str(error).rstrip('.')}; {RESUME.format(quoted(folder))}."},)
    return _answer(study)


def _who_works(study: Study, *, running: bool | None) -> Iterator[str]:
    """Say whether the members that are missing will come."""
    if running:
        yield "a process is working on it now."
    elif study.count("unfinished"):
        cause = "no process is" if running is False else "it cannot be seen whether a process is"
        yield f"{cause} working on it: {RESUME.format(quoted(study.folder))}."


def _checked(folder: Path, trust: bool) -> Answer:
    """Return what is whole in a study; what can be mended is mended first."""
    require_file(folder / DATABASE)
    with locked(folder, trust=trust):
        if not is_study(folder):  # a damaged database was set aside
            return ({"error": f"no member is complete; {RESUME.format(quoted(folder))}."},)
        return _answer(read_study(folder))


def _answer(study: Study) -> Answer:
    """Return the answer of a study, an error if members are missing."""
    answer = as_json(study)
    missing = [member.name for member in study.members if member.status != "done"]
    if missing:
        # A script must notice that members are missing, although the others have answers.
        hint = f"; {RESUME.format(quoted(study.folder))}" if study.count("unfinished") else ""
        answer["error"] = (
            f"{len(missing)} of {len(study.members)} members have no answer: {some(missing)}{hint}."
        )

    return answer, str(study)


def _listed(members: Sequence[Member]) -> Answer:
    """Return the names of members and their numbers of starts."""
    starts = {member.name: member.start_count for member in members}
    # By default a search runs only the promising starts, as long as these agree.
    total = f"{counted(len(starts), 'member')}, at most {counted(sum(starts.values()), 'start')}"
    rows = [[name, str(count)] for name, count in starts.items()]
    errors = [f"{m.name} fails: {m.problem}" for m in members if not m.problem.parts]
    return {"starts": starts}, text_table(["member", "starts"], rows), *errors, total


def quoted(path: Path) -> str:
    """Return a path as a shell reads it."""
    return shlex.quote(str(path))


def as_json(study: Study) -> dict[str, Any]:
    """Return the members of a study by name."""
    members = [
        attributes(member, "name", "status", "runs")
        | {"error": member.error or None, "answer": member.answer or None}
        for member in study.members
    ]
    return {"study": study.folder, "members": members}
