"""Values for the workers of the user's own executor: the only bytes that greybox unpickles.

They go to nobody else, and are never read from a file.
"""

import pickle
from contextlib import suppress
from typing import Any


def pickled(value: Any) -> bytes:
    """Return a value for a worker, as bytes.

    Raises
    ------
    pickle.PicklingError, TypeError, AttributeError
        If a part of it cannot travel.
    """
    return pickle.dumps(value)


def pickled_or_empty(value: Any) -> bytes:
    """Return a value for a worker; no bytes if it cannot travel."""
    with suppress(Exception):
        return pickle.dumps(value)
    return b""


unpickled = pickle.loads
