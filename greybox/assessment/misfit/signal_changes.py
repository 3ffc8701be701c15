"""What changes a signal: functions of the samples (n,) of a stretch and their step, s."""

import numpy as np

from greybox.data.files.arrays import Array


def rate(piece: Array, step: float) -> Array:
    """Return the rate without later values, which may respond to the present noise."""
    return np.diff(piece, prepend=piece[0]) / step


def delayed(piece: Array, step: float, delay: float) -> Array:
    """Return the signal delayed by so many seconds."""
    samples = np.arange(len(piece))
    return np.interp(samples - delay / step, samples, piece)


def following(piece: Array, step: float, reach: float, is_slow: bool) -> Array:
    """Return the lag of what follows the signal by `reach` a sample, or with such a play."""
    y, moved = float(piece[0]), []
    for u in piece.tolist():
        a, b = (u, y) if is_slow else (y, u)
        # The functions `min` and `max` take three times as long.
        y = b + reach if a > b + reach else b - reach if a < b - reach else a
        moved.append(y)
    return np.array(moved) - piece


def filtered(piece: Array, step: float, numerator: Array, poles: Array) -> Array:
    """Return the signal behind a digital filter, from rest."""
    # As `scipy.signal.lfilter`, which takes a third of a second to import.
    from scipy.linalg import get_blas_funcs  # noqa: PLC0415  (see `greybox.engine.compiled.condensing`)

    moved = np.convolve(piece - piece[0], numerator)[: len(piece)]
    bands = np.repeat(poles[:, None], len(piece), axis=1)
    (tbsv,) = get_blas_funcs(("tbsv",), (bands,))
    return tbsv(len(poles) - 1, bands, moved, lower=1)
