"""A batch of fits, which stores every run soon after it is made; a killed batch resumes.

Begin with `batch`.
"""

import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import field, fields
from pathlib import Path
from typing import Any

import numpy as np

from greybox.assessment.fit import SolverChoice, fingerprint, fit_with_storage
from greybox.assessment.printed import data_names, summary
from greybox.assessment.storage import to_bytes
from greybox.data.files.argument_checks import require_kind
from greybox.data.files.control_characters import printable
from greybox.data.files.error_place import error_sentence
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.normalization import normalize
from greybox.data.files.progress import bar
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.data.frequency_response import FrequencyResponse
from greybox.engine.compiled.compiled_problem import AnyProblem, require_problem
from greybox.engine.compiled.transcription.method import Transcription
from greybox.engine.solve.executors import require_executor, run_all
from greybox.engine.solve.interruption import (
    Interrupted,
    Response,
    end_after,
    is_search_over,
    limited,
    listening,
    one_interrupt,
    raise_interrupt,
    responding,
)
from greybox.engine.solve.local_solver import LocalSolver, Runner
from greybox.engine.solve.lost_workers import ExecutorLostError
from greybox.engine.solve.response_solver import ResponseSolver
from greybox.engine.solve.run_storage import RunStorageError
from greybox.engine.solve.runs import Outcome
from greybox.engine.solve.search_method import BATCHED, AnySearch
from greybox.engine.solve.worker_payload import pickled_or_empty, unpickled
from greybox.modeling.fingerprint import value_fingerprint
from greybox.modeling.formulation.starts import AnyStarts, as_starts
from greybox.modeling.traced_once import unchanged, unchanged_in
from greybox.workflows.study.data_file import UnreadableError
from greybox.workflows.study.database import is_study
from greybox.workflows.study.members import StudyMember, add_members
from greybox.workflows.study.ranking import held_out_error
from greybox.workflows.study.stored_runs import UNWRITTEN, StoredRuns
from greybox.workflows.study.study import Study, read_study
from greybox.workflows.study.study_lock import locked


@public
@frozen
class Member:
    """One fit of a batch: a problem, and the other arguments of `greybox.fit`.

    Parameters
    ----------
    problem : Problem or a sum of problems
        A grid may contain an `UnreadableError` in place of a problem whose data cannot be read.
        Only this member then fails.
    starts, seed, method, search, solver_options
        As in `greybox.fit`.
    held : sequence of Record or FrequencyResponse
        Data that are held out: `Study.ranking` compares how well structures predict them.
    name : str
        By default the name of the problem. Members of a batch have different names.
    """

    problem: AnyProblem | UnreadableError
    starts: AnyStarts | None = None
    seed: int | None = None
    method: Transcription | None = None
    solver_options: Mapping[str, Any] = field(default_factory=dict)
    name: str = ""
    search: AnySearch = BATCHED
    held: Sequence[Any] = ()

    def __post_init__(self) -> None:
        """Use the name of the problem by default, and refuse invalid arguments."""
        if not isinstance(self.problem, UnreadableError):
            require_problem(self.problem)
        # Both raise an error for invalid options, starts or seeds.
        _ = self.by
        _ = self.start_count
        if not self.name:
            normalize(self, name=self.problem.name)
        if self.name != printable(self.name):
            raise ValueError(
                f"name={self.name!r} has characters that cannot be printed: omit them."
            )

    @property
    def by(self) -> SolverChoice:
        """The method, the search and its options."""
        return SolverChoice(self.method, self.search, self.solver_options)

    @property
    def start_count(self) -> int:
        """Number of starts, by default that of the solver; one for a rule without a number."""
        only_responses = all(
            isinstance(part.data, FrequencyResponse) for part in self.problem.parts
        )
        default = ResponseSolver.starts if only_responses else LocalSolver.starts
        rule = as_starts(default if self.starts is None else self.starts, self.seed)
        return getattr(rule, "number", 1)


@public
def batch(
    members: Sequence[Member | AnyProblem],
    folder: str | Path,
    *,
    executor: Executor | None = None,
    seconds: float | None = None,
    progress: bool = True,
    trust: bool = False,
) -> Study:
    """Fit many problems, one after the other, and store every run in a folder.

    A batch that has ended in any way, `kill -9` included, resumes when it is called again with the
    same members and folder. Stored runs are not made again: each worker loses at most about two
    seconds of work, and the answer equals that of an uninterrupted batch. Members that have failed
    are tried again. If more starts of the same seed are requested, the stored runs of a member
    still count. New members are added to the folder.

    Parameters
    ----------
    members : sequence of Member, Problem or sums of problems
    folder : str or Path
        Created if it does not exist; `greybox.workflows.study.database` describes its files.
    executor : concurrent.futures.Executor, optional
        Makes the runs, as in `greybox.fit`.
    seconds : float, optional
        Time limit of the batch. Members that are not finished by then stay unfinished, and the same
        call resumes with them.
    progress : bool
        Show a progress bar in a terminal or notebook after two seconds.
    trust : bool
        Whether to use runs and answers in the folder that another user or another machine made.

    Returns
    -------
    Study
        A member that failed does not stop the others.

    Raises
    ------
    ValueError, TypeError
        For invalid arguments, and if the folder has another problem under the name of a member, or
        runs that another user made, without `trust`.
    OSError
        If the folder cannot be written, or another process writes to it. The stored runs stay
        usable.
    RuntimeError
        If the executor has lost its workers; the same call resumes with another executor.
    KeyboardInterrupt
        After Ctrl-C. Its attribute ``study`` has the results so far; it is None if the folder has
        no study yet. Members that were not assessed yet are unfinished.

    Examples
    --------
    >>> from greybox.problems import pitch_hover, roll_hover
    >>> members = [gb.study.Member(m.problem(), starts=8) for m in (pitch_hover, roll_hover)]
    >>> study = gb.batch(members, "axes", progress=False)
    >>> study
    <Study axes, 2 members: 2 done>
    """
    require_kind("members", members, Iterable, "a list of problems, or of members")
    listed = [member if isinstance(member, Member) else Member(member) for member in members]
    require_distinct(listed)
    require_executor(executor)
    models = set()
    for member in listed:
        models |= {type(part.model) for part in member.problem.parts}
    end = end_after(seconds)
    folder = Path(folder)
    with listening(), limited(end), unchanged():
        try:
            with one_interrupt(), locked(folder, trust=trust):
                _fit_all(listed, folder, executor, is_shown=progress)
            return read_study(folder, [*models])
        except KeyboardInterrupt as pressed:
            with responding(Response.FINISH):
                study = read_study(folder, [*models]) if is_study(folder) else None
            message = f"interrupted; the same batch resumes from {folder}"
            raise Interrupted(message, study=study) from pressed


def _fit_all(
    listed: Sequence[Member], folder: Path, executor: Executor | None, *, is_shown: bool
) -> None:
    """Fit the members that are not done, and store runs and answers in the locked folder."""
    # All members are added before the first fit, so that a reader sees the whole study.
    stored = add_members(folder, [member.name for member in listed])
    runs = StoredRuns(folder)
    done = {member.name for member in listed if stored[member.name].status == "done"}
    # A notebook stores every update of the bar, so that it has at most two a second. The remaining
    # time follows from the mean of all members (smoothing=0): a moving mean would count only the
    # time since the last update.
    progress_bar = bar(
        is_shown=is_shown,
        total=len(listed),
        initial=len(done),
        unit="fit",
        miniters=0,
        mininterval=0.5,
        smoothing=0,
    )
    with progress_bar:
        try:
            # Workers fit whole members that have no run yet, as long as these are small.
            new = [member for member in listed if executor and not stored[member.name].runs]
            changes_by_workers = _by_workers(new, executor)
            names_of_new = {member.name for member in new}
            compiled: set[str] = set()
            for member in listed:
                if is_search_over():
                    break
                changes = []
                if member.name in names_of_new:
                    changes = next(changes_by_workers, [])
                if changes:
                    runs.changes += changes
                else:
                    _fit_member(member, runs, stored[member.name], compiled, executor, progress_bar)
                # Ctrl-C may have come while an answer was stored.
                raise_interrupt()
                progress_bar.update(member.name not in done)
                runs.write_due()
                # The disk is full. The last attempt to write, below, raises the error.
                if runs.trouble:
                    break
        finally:
            runs.write()


def require_distinct(members: Sequence[Member]) -> None:
    """Raise ValueError if no member can be fitted, or if two members have the same name."""
    if not members:
        raise ValueError("members is empty: give at least one problem.")
    if not any(member.problem.parts for member in members):
        raise ValueError(str(members[0].problem))
    [(name, count)] = Counter(member.name for member in members).most_common(1)
    if count > 1:
        raise ValueError(
            f"{counted(count, 'member')} have the name {name!r}: give different names."
        )


class _Unwritten(StoredRuns):
    """Runs of a worker, which the process of the batch writes."""

    def write_due(self) -> None:
        """Write nothing."""


class _WholeMembers(Runner):
    """Fits whole members on workers.

    A start is an array (1,) with a pickled member. The estimate of an outcome is the list of
    changes to store. It is empty if the member takes longer than `UNWRITTEN`: workers then share
    its runs.
    """

    def run(self, start: Any) -> Outcome:
        """Fit a member."""
        began = time.perf_counter()
        runs = _Unwritten(Path())
        changes: Any = []
        # A member that cannot be pickled, or whose classes the worker lacks, is fitted later in
        # the process of the batch.
        with suppress(Exception), limited(end_after(UNWRITTEN)):
            member, key, study = unpickled(start[0])
            without_runs = StudyMember(Path(), 0, member.name, {}, 0)
            with unchanged(study):
                _fit_member(member, runs, without_runs, set(), key=key)
            if not is_search_over():
                changes = runs.changes
        return Outcome(changes, "", 0, time.perf_counter() - began, converged=True)


def _by_workers(members: Sequence[Member], executor: Executor | None) -> Iterator[Any]:
    """Yield the changes to store for every member, in their order.

    They are empty for a member that takes long, or whose worker was lost. If the first member takes
    long, nothing is yielded: members of a study are mostly alike.
    """
    study = unchanged_in.get()

    def numbered() -> Iterator[tuple[int, Any]]:
        """Yield the number of every member, and a start for `_WholeMembers`."""
        for number, member in enumerate(members):
            # The key is computed here. In a worker, classes of the user's script belong to another
            # module, and the key would differ.
            yield number, np.array([pickled_or_empty((member, _key(member), study))])

    for number, _, outcome in run_all(_WholeMembers(), numbered(), len(members), executor):
        changes = [] if outcome.status else outcome.estimate
        if number == 0 and not changes:
            return
        yield changes


def _fit_member(
    member: Member,
    runs: StoredRuns,
    stored: StudyMember,
    compiled: set[str],
    executor: Executor | None = None,
    bar: Any = None,
    key: str = "",
) -> None:
    """Fit a member, unless it is done, and store its runs and its answer.

    If the fit raises an error, the answer is this error. `compiled` are the keys of formulas, see
    `_is_done`, and `key` identifies the settings of the member, if it is known.
    """
    if _is_done(member, stored, compiled):
        return
    runs.begin(member.name, is_new=not stored.stored_runs)

    def report(done: int, count: int) -> None:
        bar.set_description_str(
            f"{member.name}: {done} of {counted(count, 'start')}", refresh=False
        )
        bar.update(0)  # shows it if the last update is old

    result = None
    error = ""
    try:
        if isinstance(member.problem, UnreadableError):
            raise member.problem
        result = fit_with_storage(
            runs,
            member.problem,
            member.starts,
            member.seed,
            by=member.by,
            executor=executor,
            profiles=False,  # `greybox profile` makes them for the member that matters
            progress=bar is not None and report,
        )
        if not result.converged:
            error = ": ".join([result.status, *result.warnings[:1]])
    except (ExecutorLostError, RunStorageError):
        # The workers or the folder are at fault, and not the member.
        raise
    # Any other error ends only this member: a batch runs for days without its user.
    except Exception as raised:
        raise_interrupt(raised)
        error = error_sentence(raised)
    raise_interrupt()
    # If the search was cut short, its runs are stored but no answer is: the next call would take it
    # for the answer from all starts.
    if is_search_over():
        return

    marks = {
        "fingerprint": runs.fingerprint,
        "stated": key or _key(member),
        "asked": _asked(member),
        "finished": time.time(),
    }
    answer = summary(result) if result else _stated(member.problem)
    answer = {**answer, **marks}
    if member.held and result:
        answer["held_out"] = held_out_error(result, member.held)
    if error:
        answer["error"] = error
    with responding(Response.FINISH):
        fit = to_bytes(result) if result else b""
        runs.finish(answer, fit)


def _stated(problem: AnyProblem | UnreadableError) -> dict[str, Any]:
    """Return the fields of a summary that distinguish a failed member from others."""
    parts = problem.parts
    models = unique(part.model.label for part in parts)
    return {
        "model": models,
        "data": data_names(parts, models),
        "criterion": "; ".join(unique(part.criterion.name for part in parts)),
    }


def _key(member: Member, *, formulas_alone: bool = False) -> str:
    """Return a key of all settings of a member, or of its formulas alone.

    It is empty if some setting, such as a lambda, has no fingerprint.
    """
    parts = member.problem.parts
    by = member.by
    formulas = [
        (
            part.model,
            part.criterion,
            part.tied,
            part.constraints,
            getattr(part.data, "output", ""),
        )
        for part in parts
    ]
    with suppress(Exception):
        if formulas_alone:
            return value_fingerprint(formulas)
        stated = []
        for part in parts:
            stated.append([getattr(part, field.name) for field in fields(part) if field.init])
        return value_fingerprint((formulas, stated, by.method, by.search, dict(by.options)))
    return ""


def _is_done(member: Member, stored: StudyMember, compiled: set[str]) -> bool:
    """Return whether a member has a usable answer from the requested starts.

    Compiling a member, which shows that nobody has changed its formulas, takes ten times as long as
    comparing its settings. Only the first of the members with the same formulas is compiled, and
    the keys of these formulas are added to `compiled`.

    Raises
    ------
    ValueError
        If the stored answer is that of another problem.
    """
    # A failed member is tried again: the cause, such as a missing file, may be gone.
    if stored.status != "done":
        return False
    # If the data cannot be read any more, the earlier answer remains.
    if isinstance(member.problem, UnreadableError):
        return True
    formulas = _key(member, formulas_alone=True)
    key = _key(member)
    is_same = key and formulas in compiled and stored.answer.get("stated") == key
    if not is_same and stored.answer.get("fingerprint") != fingerprint(member.problem, member.by):
        raise ValueError(
            f"the answer of {member.name!r} in this study belongs to another problem, to other "
            "options, or to another version of greybox or CasADi: repeat what the study began "
            "with, or begin another study."
        )
    compiled.add(formulas)
    return stored.answer.get("asked") == _asked(member)


def _asked(member: Member) -> str:
    """Return the requested starts, and the data that are held out, as text."""
    held = [data.checksum for data in member.held]
    return f"{member.starts!r}, seed {member.seed!r}{held or ''}"
