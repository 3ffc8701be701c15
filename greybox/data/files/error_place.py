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

    place = ""
    # An error in a user's file may be raised anew, with the original as its cause. The last place
    # counts.
    for cause in (error, error.__cause__):
        for frame, line in traceback.walk_tb(cause and cause.__traceback__):
            code = frame.f_code.co_filename
            is_ours = frame.f_globals.get("__name__", "").startswith("greybox.")
            is_package = code.startswith(OTHERS) or "site-packages" in code  # or of another one
            if not is_ours and not is_package:
                place = f"{_name(Path(code))}, line {line}: "
    return place
