"""Runs that are left where their limit of iterations ends them."""

from contextlib import contextmanager

import pytest

from greybox.engine.solve.gauss_newton.driver import GaussNewton


@contextmanager
def without_continued_runs():
    """Keep the record solver from continuing an unfinished run at the lowest cost."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(GaussNewton, "continued", lambda _, outcome: outcome)
        yield
