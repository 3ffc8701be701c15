"""Where an error arose in a file of the user."""

import site
import traceback
from pathlib import Path

# Beginnings of the files of packages and of Python, and of code without a file. Their common prefix
# may be /usr, where users have files, too.
OTHERS = (
    *site.getsitepackages(),
    site.getusersitepackages(),
    str(Path(traceback.__file__).parent),
    "<",
)


def _name(file: Path) -> str:
    # The file of a notebook's cell is temporary, and its name a random number.
    return "cell of the notebook" if file.parent.name.startswith("ipykernel_") else file.name


def error_place(error: BaseException) -> str:
    """Return the file and the line of an error, to begin a sentence with; else ""."""
    file = getattr(error, "filename", None) or "<"
    if isinstance(error, SyntaxError) and not file.startswith(OTHERS):
        return f"{Path(file).name}, line {error.lineno}: "
    # An error in a user's file may be raised anew, with the original as its cause.
    places = [
        f"{_name(Path(frame.f_code.co_filename))}, line {line}: "
        for cause in (error, error.__cause__)
        for frame, line in traceback.walk_tb(cause and cause.__traceback__)
        if not frame.f_globals.get("__name__", "").startswith("greybox.")
        and not frame.f_code.co_filename.startswith(OTHERS)
    ]
    return places[-1] if places else ""
