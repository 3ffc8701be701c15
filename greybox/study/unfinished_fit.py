"""The runs of a single fit, kept in a folder beside its file until that is written."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from greybox.solve.interruption import Response, responding
from greybox.study.run_files import RunFiles, count_runs
from greybox.study.study_folder import LOCK, locked


class RunsBesideFit(RunFiles):
    """Runs that are kept as long as there is space: a full disk does not end the fit.

    Attributes
    ----------
    trouble : str
        Why the last of them were not written; empty where they were.
    """

    trouble = ""

    def write(self) -> None:
        """Write what is due, or try again later."""
        try:
            super().write()
            self.trouble = ""
        except OSError as error:
            self.trouble = str(error)


def runs_beside(path: Path) -> Path:
    """Return the folder of the runs of a fit that is saved to a file."""
    return path.with_name(f"{path.name}.runs")


@contextmanager
def kept_beside(path: Path) -> Iterator[RunsBesideFit]:
    """Keep runs beside a file within, also those of a fit that an error ends; a folder without runs is removed.

    Raises
    ------
    OSError
        If the folder cannot be written, or another process writes to it.
    """
    folder = runs_beside(path)
    try:
        with locked(folder):
            kept = RunsBesideFit(folder)
            try:
                yield kept
            except BaseException:
                with responding(Response.FINISH):
                    kept.write()
                raise
    finally:
        if folder.is_dir() and not count_runs(folder):
            with suppress(OSError):  # another process has begun there
                (folder / LOCK).unlink(missing_ok=True)
                folder.rmdir()
