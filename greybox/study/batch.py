"""A batch of fits: every run is on disk soon after it is made, and a batch that was killed goes on."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tqdm import tqdm

from greybox.compiled.compiled_problem import AnyProblem
from greybox.compiled.transcription.method import Transcription
from greybox.estimate.fit import SolverChoice, fingerprint, fit_keeping
from greybox.estimate.result import Fit
from greybox.estimate.storage import save
from greybox.estimate.summary import summary
from greybox.files.text_table import counted, printable
from greybox.formulation.problem import Problem
from greybox.formulation.starts import Starts
from greybox.formulation.sum import Sum
from greybox.solve.executors import ExecutorLostError, require_executor
from greybox.solve.interruption import Response, listening, responding
from greybox.solve.kept_runs import KeptRunsError
from greybox.solve.multistart import BATCHED
from greybox.solve.time_limits import TimeLimits, is_search_over, limited
from greybox.study.store import StoredMember, StoredRuns, add_members, locked, write_answer
from greybox.study.study import Study, read_study

DISPLAY = "{percentage:3.0f}%|{bar:20}| {elapsed}<{remaining}  {desc}"
SHARE = (
    0.99  # of a member's time that its runs take, for the display: the judgment comes after them
)

# A problem that cannot be fitted ends its own member; anything else is a mistake of the program.
MEMBER_ERRORS = (ValueError, TypeError, ArithmeticError, LookupError, RuntimeError)


@dataclass(frozen=True, eq=False)
class Member:
    """One fit of a batch: a problem, and what `greybox.fit` takes besides.

    Parameters
    ----------
    problem : Problem or a sum of problems
    starts, seed, method, search, solver_options
        As of `greybox.fit`.
    name : str
        The problem's by default; no two members have the same.
    """

    problem: AnyProblem
    starts: int | Starts | Sequence[Mapping[str, float] | Starts] | None = None
    seed: int | None = None
    method: Transcription | None = None
    solver_options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    name: str = ""
    search: str = BATCHED

    def __post_init__(self) -> None:
        """Take the problem's name where none is given."""
        if not isinstance(self.problem, Problem | Sum):
            raise TypeError(
                f"problem is {self.problem!r:.80}: give a Problem(model, data) or a sum of them."
            )
        self.by  # noqa: B018  (checks what it is made of)
        if not self.name:
            object.__setattr__(self, "name", self.problem.name)
        if self.name != printable(self.name):
            raise ValueError(f"name is {self.name!r}: leave out what cannot be printed.")

    @property
    def by(self) -> SolverChoice:
        """What solves it."""
        return SolverChoice(self.method, self.search, self.solver_options)


class BatchInterrupted(KeyboardInterrupt):
    """Ctrl-C during a batch.

    Attributes
    ----------
    study : Study
        What was done; the same call goes on.
    """

    def __init__(self, study: Study) -> None:
        super().__init__(study)
        self.study = study

    def __str__(self) -> str:
        return f"interrupted; what was done is in {self.study.folder}, and the same batch goes on from there"


def batch(
    members: Sequence[Member | AnyProblem],
    folder: str | Path,
    *,
    executor: Executor | None = None,
    seconds: float | None = None,
    start_seconds: float | None = None,
    progress: bool = True,
) -> Study:
    """Fit many problems, one after the other, and keep every run in a folder.

    A batch that ended in any way, `kill -9` included, goes on when it is begun again with the same
    members and folder: runs that are on disk are not made again, at most some two seconds of work
    of each worker are lost, and the answer is that of a batch that was never interrupted. Members
    that failed are tried again. A member with more starts of the same seed keeps the runs that it
    has; new members are added to those in the folder.

    Parameters
    ----------
    members : sequence of Member, Problem or sums of problems
    folder : str or Path
        Is made where it does not exist; see `greybox.study.store` for what is in it.
    executor : concurrent.futures.Executor, optional
        What makes the runs, as of `greybox.fit`.
    seconds : float, optional
        After which the batch ends; the member at hand and those that follow are then unfinished,
        and the same batch goes on with them.
    start_seconds : float, optional
        The same for the runs from each start. Those that it cuts count with what they reached, and
        are made again when the member is fitted with a longer one.
    progress : bool
        A bar on a terminal for anything longer than two seconds.

    Returns
    -------
    Study
        A member that failed does not stop the others.

    Raises
    ------
    ValueError, TypeError
        For bad input, in one sentence; and when a member is not the problem that the folder has
        under its name.
    OSError
        When the folder cannot be written, or another process is at work on it. What was written
        stays usable.
    RuntimeError
        When the executor has lost its workers; the same batch goes on with another.
    KeyboardInterrupt
        After Ctrl-C; its attribute ``study`` is what was done.
    """
    listed = [member if isinstance(member, Member) else Member(member) for member in members]
    require_distinct(listed)
    require_executor(executor)
    limits = TimeLimits.from_now(seconds, start_seconds)
    folder = Path(folder)
    with locked(folder), limited(limits):
        stored = add_members(folder, [member.name for member in listed])
        try:
            with listening(), _shown(listed, progress) as bar:
                for member in listed:
                    if is_search_over():
                        break
                    _fit_member(member, folder, stored[member.name], executor, bar)
        except KeyboardInterrupt as pressed:
            raise BatchInterrupted(read_study(folder)) from pressed
        return read_study(folder)


def require_distinct(members: Sequence[Member]) -> None:
    """Refuse a batch without members, or of two with one name.

    Raises
    ------
    ValueError
    """
    if not members:
        raise ValueError("members is empty: give at least one problem.")
    names = [member.name for member in members]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(
                f"{counted(names.count(name), 'member')} have the name {name!r}: name them apart."
            )


@contextmanager
def _shown(members: Sequence[Member], progress: bool) -> Iterator["_Display"]:
    with tqdm(
        total=len(members),
        disable=None if progress else True,
        delay=2,
        leave=False,
        bar_format=DISPLAY,
    ) as bar:
        yield _Display(bar)


class _Display:
    """How far a batch is."""

    def __init__(self, bar: Any) -> None:
        self._bar = bar
        self._done = 0
        self._failed = 0

    def begin(self, name: str) -> Callable[[int, int], None]:
        """Return what reports the runs of a member."""

        def report(done: int, count: int) -> None:
            members = f"{self._done} of {self._bar.total} done{self._failures}"
            self._bar.set_description_str(
                f"{members}; {name}: {done} of {counted(count, 'start')}", refresh=False
            )
            self._bar.update(self._done + SHARE * done / count - self._bar.n)

        return report

    def end(self, *, failed: bool) -> None:
        """Count a member that is done."""
        self._done += 1
        self._failed += failed
        self._bar.update(self._done - self._bar.n)

    @property
    def _failures(self) -> str:
        return f", {self._failed} failed" if self._failed else ""


def _fit_member(
    member: Member, folder: Path, stored: StoredMember, executor: Executor | None, bar: _Display
) -> None:
    """Fit a member, unless it is done; an error of its own is its answer."""
    if _is_done(member, stored):
        bar.end(failed=False)
        return
    kept = StoredRuns(folder, member.name)
    report = bar.begin(member.name)
    result, error = None, ""
    try:
        result = _fitted(member, kept, executor, report)
        error = "" if result.converged else ": ".join([result.status, *result.warnings[:1]])
    except (ExecutorLostError, KeptRunsError):
        raise
    except MEMBER_ERRORS as raised:
        error = " ".join(str(raised).split()) or type(raised).__name__
    finally:
        with responding(Response.FINISH):
            kept.write()
    if is_search_over():  # its runs are kept, and the rest of it is left for the next time
        return

    marks = {"fingerprint": kept.fingerprint, "asked": _asked(member)}
    answer = {**(summary(result) if result else {}), **marks}
    with responding(Response.FINISH):
        if result is not None:
            save(result, stored.fit_file(folder))
        # The answer says that the member is done, so it comes last.
        write_answer(folder, member.name, {**answer, "error": error} if error else answer)
    bar.end(failed=bool(error))


def _fitted(
    member: Member, kept: StoredRuns, executor: Executor | None, report: Callable[[int, int], None]
) -> Fit:
    return fit_keeping(
        kept,
        member.problem,
        member.starts,
        member.seed,
        by=member.by,
        executor=executor,
        profiles=False,  # of the member that matters, `greybox profile` makes them
        progress=report,
    )


def _is_done(member: Member, stored: StoredMember) -> bool:
    """Return whether a member has a usable answer from the starts that are asked for.

    Raises
    ------
    ValueError
        If it is the answer to another problem.
    """
    if not stored.answer or stored.answer.get("error"):
        return False
    if stored.answer.get("fingerprint") != fingerprint(member.problem, member.by):
        raise ValueError(
            f"the study has the answer to another problem under the name {member.name!r}, or to other options, or of "
            "another version of greybox or CasADi: give what the study was begun with, or begin another one."
        )
    return stored.answer.get("asked") == _asked(member)


def _asked(member: Member) -> str:
    """Return the starts that are asked for, as text."""
    return f"{member.starts!r}, seed {member.seed!r}"
