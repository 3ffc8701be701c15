"""Keys of values, equal in every process."""

import copyreg
import hashlib
import io
import pickle
from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca

# Problems of the same formulas share functions, and to serialize them takes a millisecond: their
# text is represented by a short key.
_serialized: WeakKeyDictionary[ca.Function, str] = WeakKeyDictionary()


def _reduced(function: ca.Function) -> tuple[type[str], tuple[str]]:
    """Return a function for a pickle whose contents only make a key; serialize it once."""
    if function not in _serialized:
        _serialized[function] = hashlib.sha256(function.serialize().encode()).hexdigest()
    return str, (_serialized[function],)


def value_fingerprint(value: Any) -> str:
    """Return a key of a value, such as a runner, that is the same in every process."""
    text = io.BytesIO()
    pickler = pickle.Pickler(text)
    pickler.dispatch_table = {**copyreg.dispatch_table, ca.Function: _reduced}
    # References to earlier objects would distinguish equal strings from identical ones.
    pickler.fast = True
    pickler.dump(value)
    return hashlib.sha256(text.getvalue()).hexdigest()
