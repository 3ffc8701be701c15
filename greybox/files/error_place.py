"""An error as a sentence, with the place in a file of the user where it arose."""

import re
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

# Errors of a user's input, whose messages say enough; of others the class is named, too.
SENTENCES = (ValueError, TypeError, RuntimeError)
MOST = 500  # letters of a message


def error_sentence(error: BaseException) -> str:
    """Return the message of an error in one line, after its place in a file of the user."""
    message = str(error)
    # CasADi lists the functions that called one another, and its own files; the reason is last.
    if message.startswith("Error in "):
        message = re.sub(r"^\S+:\d+: ", "", message.splitlines()[-1])
    message = " ".join(message.split())
    message = message if len(message) <= MOST else f"{message[:MOST]}..."
    if not (message and isinstance(error, SENTENCES)):
        message = f"{type(error).__name__}: {message}".rstrip(": ")
    return error_place(error) + message


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
        and "site-packages" not in frame.f_code.co_filename  # of another environment
    ]
    return places[-1] if places else ""
