"""Sobol points in the unit cube, scrambled: those of `scipy.stats.qmc`, whose import takes longer than many a fit.

The sequence is that of Sobol (1967) with the direction numbers of Joe and Kuo (2008, SIAM Journal on Scientific
Computing 30); it is scrambled by random lower triangular matrices of bits and a digital shift (Matoušek 1998, Journal
of Complexity 14).
"""

import math

import numpy as np
from numpy.typing import NDArray

BITS = 30  # of a coordinate, most significant first: points are told apart to a billionth

# Primitive polynomial, its coefficients as bits, and first direction numbers of every coordinate from the second on.
_JOE_KUO = """
3 1; 7 1 3; 11 1 3 1; 13 1 1 1; 19 1 1 3 3; 25 1 3 5 13; 37 1 1 5 5 17; 41 1 1 5 5 5; 47 1 1 7 11 19; 55 1 1 5 1 1;
59 1 1 1 3 11; 61 1 3 5 5 31; 67 1 3 3 9 7 49; 91 1 1 1 15 21 21; 97 1 3 1 13 27 49; 103 1 1 1 15 7 5; 109 1 3 1 15 13
25; 115 1 1 5 5 19 61; 131 1 3 7 11 23 15 103; 137 1 3 7 13 13 15 69; 143 1 1 3 13 7 35 63; 145 1 3 5 9 1 25 53; 157 1
3 1 13 9 35 107; 167 1 3 1 5 27 61 31; 171 1 1 5 11 19 41 61; 185 1 3 5 3 3 13 69; 191 1 1 7 13 1 19 1; 193 1 3 7 5 13
19 59; 203 1 1 3 9 25 29 41; 211 1 3 5 13 23 1 55; 213 1 3 7 3 13 59 17; 229 1 3 1 3 5 53 69; 239 1 1 5 5 23 33 13; 241
1 1 7 7 1 61 123; 247 1 1 7 9 13 61 49; 253 1 3 3 5 3 55 33; 285 1 3 1 15 31 13 49 245; 299 1 3 5 15 31 59 63 97; 301 1
3 1 11 11 11 77 249
"""
MOST = 1 + _JOE_KUO.count(";") + 1  # coordinates

_PLACES = 2 ** np.arange(BITS, dtype=np.int64)[::-1]  # of the bits


def sobol_points(number: int, size: int, seed: int) -> NDArray[np.float64]:
    """Return the first points of a scrambled sequence, (number, size); more with the same seed begin with the same."""
    if size > MOST:
        from scipy.stats import qmc  # noqa: PLC0415  (scipy.stats takes a third of a second to import)

        sequence = qmc.Sobol(size, scramble=True, rng=np.random.default_rng(seed))
        return sequence.random_base2(math.ceil(math.log2(number)))[:number]
    (rng,) = np.random.default_rng(seed).spawn(1)  # as scipy does
    shift = rng.integers(2, size=(size, BITS), dtype=np.uint32) @ _PLACES[::-1]
    lower = np.tril(rng.integers(2, size=(size, BITS, BITS), dtype=np.uint32), -1) + np.eye(BITS, dtype=np.int64)
    bits = (_directions(size)[:, None, :] & _PLACES[:, None]) != 0
    directions = np.tensordot(_PLACES, lower @ bits % 2, (0, 1))
    # From one point to the next changes the direction of the lowest bit in which their Gray codes differ.
    after = np.arange(1, number)
    changes = directions[:, np.log2(after & -after).astype(int)]
    steps = np.concatenate([shift[:, None], changes], axis=1)
    return np.bitwise_xor.accumulate(steps, axis=1).T / 2.0**BITS


def _directions(size: int) -> NDArray[np.int64]:
    """Return the direction numbers (size, BITS)."""
    found = np.ones((size, BITS), dtype=np.int64)
    rows = [[int(number) for number in row.split()] for row in _JOE_KUO.split(";")]
    for v, (polynomial, *first) in zip(found[1:], rows, strict=False):
        degree = len(first)
        v[:degree] = first
        for k in range(degree, BITS):
            v[k] = v[k - degree] ^ (v[k - degree] << degree)
            for j in range(1, degree):
                if polynomial >> (degree - j) & 1:
                    v[k] ^= v[k - j] << j
    return found * _PLACES
