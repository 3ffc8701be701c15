"""The command `greybox batch`: many fits, kept in a folder as they are made."""

import argparse
from pathlib import Path
from typing import Any

from greybox.cli.options import (
    UsageError,
    add_common_options,
    add_time_options,
    positive,
)
from greybox.cli.output import FAILED, INTERRUPTED, USABLE, Answer
from greybox.cli.study_file import (
    INCLUDED,
    find_study,
    read_json,
    read_study_file,
    write_json,
)
from greybox.cli.workers import add_worker_options, stated_executor
from greybox.solve.executors import ExecutorLostError
from greybox.study.batch import BatchInterrupted, batch
from greybox.study.store import is_study
from greybox.study.study import Study

ORIGIN = "origin.json"  # of a study: the study file it was begun with


EXAMPLES = (
    "study.toml --out results --workers 2",
    "--resume results --starts 400",
    "paper --out paper",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add(
        "study",
        nargs="?",
        metavar="STUDY",
        help="study.toml, study.py with a function members(), or included: paper",
    )
    add("--out", type=Path, metavar="DIR", help="keep every run and the answers in this folder")
    add(
        "--resume",
        type=Path,
        metavar="DIR",
        help="go on with the study in this folder, whatever ended it",
    )
    add(
        "--starts",
        type=positive,
        help="number of starts of every member (default: the study's, or as of greybox fit)",
    )
    add_time_options(parser, "study")
    add_worker_options(parser)
    add_common_options(parser)


def run(options: argparse.Namespace) -> Answer:
    """Run the batch, or go on with it."""
    source, folder, starts = _stated(options)
    path = find_study(source)
    members = read_study_file(path, starts)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(
        folder / ORIGIN,
        {"study": source if source in INCLUDED else str(path.resolve()), "starts": starts},
    )
    resume = f"`greybox batch --resume {folder}` goes on"
    try:
        with stated_executor(options) as executor:
            study = batch(
                members,
                folder,
                executor=executor,
                seconds=options.seconds,
                start_seconds=options.start_seconds,
            )
    except BatchInterrupted as stopped:
        answer = {**as_json(stopped.study), "error": f"interrupted; {resume}."}
        return answer, str(stopped.study), INTERRUPTED
    except (ExecutorLostError, OSError) as error:
        if isinstance(error, BlockingIOError):
            raise
        return {"error": f"{str(error).rstrip('.')}; {resume}."}, "", FAILED
    answer = as_json(study)
    bad = [member.name for member in study.members if member.status != "done"]
    if bad:
        time_is_up = any(member.status == "unfinished" for member in study.members)
        answer["error"] = (
            f"{len(bad)} of {len(study.members)} members have no answer: {', '.join(bad)}"
        )
        answer["error"] += f"; the time limit ended the study, {resume}." if time_is_up else "."
    return answer, str(study), FAILED if bad else USABLE


def _stated(options: argparse.Namespace) -> tuple[str, Path, int | None]:
    """Return the study, the folder, and the starts that are asked for."""
    if options.resume is None:
        if options.study is None or options.out is None:
            raise UsageError("give a study file and --out DIR, or --resume DIR.")
        if options.out.exists() and not options.out.is_dir():
            raise UsageError(f"{options.out} is a file: give a folder.")
        if is_study(options.out):
            raise UsageError(
                f"{options.out} has a study: go on with it by --resume {options.out}, or give another folder."
            )
        return options.study, options.out, options.starts
    if options.study is not None or options.out is not None:
        raise UsageError("--resume DIR knows its study file and its folder: leave out the others.")
    if not is_study(options.resume):
        raise UsageError(
            f"{options.resume} is no study: begin one with greybox batch STUDY --out {options.resume}."
        )
    try:
        origin = read_json(options.resume / ORIGIN)
    except FileNotFoundError:
        origin = {}
    source, starts = origin.get("study"), origin.get("starts")
    if not isinstance(source, str) or not isinstance(starts, int | None):
        raise UsageError(
            f"{options.resume} does not say which study file it is of: call gb.batch as it was begun."
        )
    return source, options.resume, options.starts or starts


def as_json(study: Study) -> dict[str, Any]:
    """Return a study as plain values."""
    members = [
        {
            "name": m.name,
            "status": m.status,
            "runs": m.runs,
            "error": m.error or None,
            "answer": dict(m.answer) or None,
        }
        for m in study.members
    ]
    return {"study": str(study.folder), "members": members}
