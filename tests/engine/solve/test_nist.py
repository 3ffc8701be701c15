"""Certified regressions.

Estimates and standard errors from NIST's own starts, as static models of rows.
"""

import numpy as np
import pytest
from nist import FORMULAS, certified

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

# From the first of their starts these end in a flat region far from the certified values.
ELSEWHERE = {("MGH10", 0), ("MGH17", 0)}

# Takes 1400 iterations, as long as all others together; `benchmarks/nist.py` makes it.
LONG = {("Bennett5", 0)}

# Its residuals are the rounding of data with 14 digits: no errors from which to certify standard
# ones.
ROUNDING = ("Lanczos1",)


def digits(values, reference):
    """Return how many digits of every value are right, at least."""
    return min(
        -np.log10(max(abs(values[name] / value - 1), 1e-15)) for name, value in reference.items()
    )


@pytest.mark.parametrize("name", FORMULAS)
def test_the_certified_values_and_errors_are_found_from_the_certified_starts(name):
    case = certified(name)
    # The first start is the one farther away.
    start = case.starts[(name, 0) in ELSEWHERE | LONG]
    fit = gb.fit(case.problem, starts=[start], profiles=False, progress=False)
    assert fit.converged, fit.status
    # Nine are right; without polishing, four to eight.
    assert digits(fit.estimate, case.values) > 8
    if name not in ROUNDING:
        # Nine are right on every processor. With a root of the information but not of the meat,
        # seven for Bennett5: two columns are collinear to 2e-5, and a square has half of the digits.
        assert digits(fit.standard_error, case.errors) > 8
        assert fit.dof == pytest.approx(len(case.problem.data) - len(case.values))


@pytest.mark.parametrize(("name", "k"), sorted(ELSEWHERE))
def test_where_the_first_start_leads_elsewhere_the_second_decides(name, k):
    case = certified(name)
    alone = gb.fit(case.problem, starts=[case.starts[k]], profiles=False, progress=False)
    both = gb.fit(case.problem, starts=list(case.starts), profiles=False, progress=False)
    assert both.cost < alone.cost - 1
    assert digits(both.estimate, case.values) > 6
    assert digits(both.standard_error, case.errors) > 4
