"""What the parts of a problem tell of themselves."""

import numpy as np
import pytest

from greybox.compiled.part import ColoredErrors


@pytest.mark.parametrize(
    ("hidden", "dof", "wider"),
    [
        (9.0, 5.0, 3 * 1.959964 / 2.570582),
        (9.0, np.inf, 3.0),
        (1.2, 5.0, 1.0),
    ],  # quantiles as in tables
)
def test_intervals_that_slow_errors_widen_have_the_normal_quantile(hidden, dof, wider):
    """And are never called narrower."""
    known = ColoredErrors(np.eye(1), dof, np.ones(1), 10.0, True, hidden, None)
    assert known.wider == pytest.approx(wider, rel=1e-6)
