"""Scrambled Sobol points, those of scipy.stats.qmc.Sobol to the last bit.

scipy.stats takes longer to import than a search of records takes for twenty starts; of more parameters than stand here
it draws the points.

Sources: Joe and Kuo (2008), Constructing Sobol sequences with better two-dimensional projections, SIAM Journal on
Scientific Computing 30(5) (direction numbers, their file new-joe-kuo-6.21201); Matousek (1998), On the L2-discrepancy
for anchored boxes, Journal of Complexity 14(4) (random linear scrambling with a digital shift).
"""

import numpy as np
from numpy.typing import NDArray

BITS = 30  # of a point

# Of every dimension after the first: its primitive polynomial over the integers modulo two, as a binary number, and the
# first direction numbers.
DIRECTIONS = (
    (3, 1),
    (7, 1, 3),
    (11, 1, 3, 1),
    (13, 1, 1, 1),
    (19, 1, 1, 3, 3),
    (25, 1, 3, 5, 13),
    (37, 1, 1, 5, 5, 17),
    (41, 1, 1, 5, 5, 5),
    (47, 1, 1, 7, 11, 19),
    (55, 1, 1, 5, 1, 1),
    (59, 1, 1, 1, 3, 11),
    (61, 1, 3, 5, 5, 31),
    (67, 1, 3, 3, 9, 7, 49),
    (91, 1, 1, 1, 15, 21, 21),
    (97, 1, 3, 1, 13, 27, 49),
    (103, 1, 1, 1, 15, 7, 5),
    (109, 1, 3, 1, 15, 13, 25),
    (115, 1, 1, 5, 5, 19, 61),
    (131, 1, 3, 7, 11, 23, 15, 103),
    (137, 1, 3, 7, 13, 13, 15, 69),
    (143, 1, 1, 3, 13, 7, 35, 63),
    (145, 1, 3, 5, 9, 1, 25, 53),
    (157, 1, 3, 1, 13, 9, 35, 107),
    (167, 1, 3, 1, 5, 27, 61, 31),
    (171, 1, 1, 5, 11, 19, 41, 61),
    (185, 1, 3, 5, 3, 3, 13, 69),
    (191, 1, 1, 7, 13, 1, 19, 1),
    (193, 1, 3, 7, 5, 13, 19, 59),
    (203, 1, 1, 3, 9, 25, 29, 41),
    (211, 1, 3, 5, 13, 23, 1, 55),
    (213, 1, 3, 7, 3, 13, 59, 17),
    (229, 1, 3, 1, 3, 5, 53, 69),
    (239, 1, 1, 5, 5, 23, 33, 13),
    (241, 1, 1, 7, 7, 1, 61, 123),
    (247, 1, 1, 7, 9, 13, 61, 49),
    (253, 1, 3, 3, 5, 3, 55, 33),
    (285, 1, 3, 1, 15, 31, 13, 49, 245),
    (299, 1, 3, 5, 15, 31, 59, 63, 97),
    (301, 1, 3, 1, 11, 11, 11, 77, 249),
)


def sobol_points(number: int, size: int, seed: int) -> NDArray[np.float64]:
    """Return the first points in the unit cube, (number, size)."""
    if size > len(DIRECTIONS) + 1:
        from scipy.stats import qmc  # noqa: PLC0415  (takes a third of a second to import)

        return qmc.Sobol(size, scramble=True, rng=np.random.default_rng(seed)).random_base2((number - 1).bit_length())[
            :number
        ]

    (random,) = np.random.default_rng(seed).spawn(1)  # as scipy does
    powers = 1 << np.arange(BITS, dtype=np.uint32)
    shift = random.integers(2, size=(size, BITS), dtype=np.uint32) @ powers
    triangles = np.tril(random.integers(2, size=(size, BITS, BITS), dtype=np.uint32))
    triangles[:, range(BITS), range(BITS)] = 1
    # Digits of direction numbers, the most significant first.
    digits = _direction_numbers(size)[:, :, None] >> np.arange(BITS - 1, -1, -1, dtype=np.uint32) & 1
    scrambled = (digits @ triangles.transpose(0, 2, 1) % 2) @ powers[::-1]

    # Point n is the sum modulo two of the direction numbers whose digits stand in the Gray code of n.
    index = np.arange(number, dtype=np.uint32)
    gray = index ^ index >> 1
    points = np.tile(shift, (number, 1))
    for digit in range(number.bit_length()):
        points ^= (gray >> digit & 1)[:, None] * scrambled[:, digit]
    return points.astype(np.float64) * 2.0**-BITS


def _direction_numbers(size: int) -> NDArray[np.uint32]:
    """Return the direction numbers (size, BITS), by the recursion over the polynomial, as fractions of 2^BITS."""
    numbers = np.ones((size, BITS), dtype=np.uint32)
    for row, (polynomial, *first) in zip(numbers[1:], DIRECTIONS, strict=False):
        degree = len(first)
        values = list(first)
        for j in range(degree, BITS):
            value = values[j - degree]
            for k in range(degree):
                if polynomial >> (degree - 1 - k) & 1:
                    value ^= values[j - k - 1] << (k + 1)
            values.append(value)
        row[:] = values
    return numbers << np.arange(BITS - 1, -1, -1, dtype=np.uint32)
