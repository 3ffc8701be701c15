"""Sobol points against those of scipy, bit for bit."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.stats import qmc

from greybox.formulation.sobol_points import MOST, sobol_points
from greybox.formulation.starts import LatinHypercube, Sobol


@pytest.mark.parametrize(("number", "size"), [(1, 3), (2, 1), (100, MOST), (1000, 5), (3, MOST + 2)])
def test_points_are_those_of_scipy(number, size):
    for seed in (0, 7):
        theirs = qmc.Sobol(size, scramble=True, rng=np.random.default_rng(seed)).random_base2(10)[:number]
        assert_array_equal(sobol_points(number, size, seed), theirs)


def test_so_are_those_of_a_latin_hypercube():
    theirs = qmc.LatinHypercube(4, rng=np.random.default_rng(3)).random(50)
    assert_array_equal(LatinHypercube(50, seed=3).unit_points(4), theirs)


def test_neither_imports_what_takes_longer_than_a_fit(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy.stats", None)  # an import of it fails
    assert Sobol(20).unit_points(MOST).shape == (20, MOST)
    assert LatinHypercube(20).unit_points(9).shape == (20, 9)
