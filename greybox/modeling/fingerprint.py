"""Keys of functions and of values."""

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


def python_callbacks(function: ca.Function) -> list[ca.Function]:
    """Return the Python callbacks among a function and the functions that it calls."""
    if function.is_null():
        return []
    called = (function, *function.find_functions())
    return [f for f in called if f.class_name() == "CallbackInternal"]


def function_key(function: ca.Function) -> str:
    """Return a key of a function, equal for equal operations and numbers.

    CasADi does not serialize what a Python callback does: two of one name would have one key. So a
    function that calls one has a key of this process alone.
    """
    identities = [hash(callback) for callback in python_callbacks(function)]
    return " ".join([function.serialize(), *map(str, identities)])


def _reduced(function: ca.Function) -> tuple[type[str], tuple[str]]:
    """Return a function for a pickle whose contents only make a key; serialize it once."""
    if function not in _serialized:
        callbacks = python_callbacks(function)
        if callbacks:
            raise ValueError(
                f"the Python callback {callbacks[0].name()!r} of the model cannot be sent to "
                "another process or stored: fit in this process alone, without workers, study or "
                "stored runs, or write it as a formula or a table (casadi.interpolant)."
            )
        _serialized[function] = hashlib.sha256(function.serialize().encode()).hexdigest()
    return str, (_serialized[function],)


def value_fingerprint(value: Any) -> str:
    """Return a key of a value, such as a runner, that is the same in every process.

    Raises
    ------
    ValueError
        If a function in it calls Python, which another process cannot do.
    """
    text = io.BytesIO()
    pickler = pickle.Pickler(text)
    pickler.dispatch_table = {**copyreg.dispatch_table, ca.Function: _reduced}
    # References to earlier objects would distinguish equal strings from identical ones.
    pickler.fast = True
    pickler.dump(value)
    return hashlib.sha256(text.getvalue()).hexdigest()
