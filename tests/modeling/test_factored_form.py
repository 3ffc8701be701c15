"""The factored form of (3.18)."""

import numpy as np
from numpy.testing import assert_allclose
from rational_functions import OMEGA, evaluated, polynomial, table

from greybox.engine.regression.levy import levy
from greybox.modeling.factored_form import factored


def test_the_factored_form_is_the_same_function():
    fit = levy(table("roll"), 4, 1)
    assert_allclose(evaluated(fit.factored, 1j * OMEGA), fit.response(OMEGA).response, rtol=2e-3)
    unstable = factored(2 * polynomial([0.2 + 10j]), polynomial([4, -0.5]))
    assert unstable == "4 (s² - 0.4 s + 100) / [(2 s + 1) (s - 4)]"
    assert factored([2.0, 0.0], [4.0]) == "0.5 s"
    assert factored([0.0], [1.0, 2.0]) == "0 / [(0.5 s + 1)]"


def test_every_kind_of_factor_is_written():
    """6 (s + 0.5) s (s² - 2 s + 5) over 2 s² (s + 4) (s + 0.5) (s - 3) (s² + 2 s + 10)."""
    above = 6 * np.real(np.poly([-0.5, 0, 1 + 2j, 1 - 2j]))
    below = 2 * np.polymul(np.poly([0, 0, -4, -0.5, 3]), [1, 2, 10])
    text = factored(np.round(above, 9), np.round(below, 9))
    assert text == (
        "1.5 s (s + 0.5) (s² - 2 s + 5) / [s s (0.25 s + 1) (2 s + 1) (s - 3) (s² + 2 s + 10)]"
    )
