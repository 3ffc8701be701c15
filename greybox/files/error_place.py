"""Where an error arose in a file of the user."""

import sys
import traceback
from pathlib import Path

OTHERS = (sys.prefix, sys.base_prefix, "<")  # beginnings of files of Python and packages


def error_place(error: BaseException) -> str:
    """Return the file and the line of an error, for the beginning of a sentence; else ""."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{Path(error.filename).name}, line {error.lineno}: "
    # An error in a user's file may be raised anew, with the original as its cause.
    places = [
        f"{Path(frame.f_code.co_filename).name}, line {line}: "
        for cause in (error, error.__cause__)
        for frame, line in traceback.walk_tb(cause and cause.__traceback__)
        if not frame.f_globals.get("__name__", "").startswith("greybox.")
        and not frame.f_code.co_filename.startswith(OTHERS)
    ]
    return places[-1] if places else ""
