"""Sobol points against those of scipy."""

import numpy as np
import pytest
from scipy.stats import qmc

from greybox.formulation.sobol_points import DIRECTIONS, sobol_points


@pytest.mark.parametrize(("number", "size", "seed"), [(1, 1, 0), (2, 3, 0), (19, 5, 0), (200, 5, 1), (1000, 40, 7)])
def test_points_are_those_of_scipy_to_the_last_bit(number, size, seed):
    sequence = qmc.Sobol(size, scramble=True, rng=np.random.default_rng(seed))
    wanted = sequence.random_base2((number - 1).bit_length())[:number]
    assert np.array_equal(sobol_points(number, size, seed), wanted)


def test_scipy_draws_points_of_more_dimensions_than_stand_here():
    size = len(DIRECTIONS) + 2
    assert sobol_points(3, size, 0).shape == (3, size)
