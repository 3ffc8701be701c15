"""Levenberg-Marquardt damping: how much after each step.

Source: Marquardt (1963), SIAM Journal on Applied Mathematics 11; the ratio of actual and predicted
decrease decides, as in Nocedal and Wright, Numerical Optimization, 2nd ed., section 10.3.
"""

from greybox.compiled.strategies import Strategies

# Damping, relative to the diagonal of the Hessian, below which it is dropped: rounding is all that
# it could hold back.
NEGLIGIBLE = 1e-12

# Share of a step below which the line search has cut it so much that more damping is wanted for the
# next.
CUT_SHORT = 0.2


def next_damping(
    settings: Strategies, damping: float, length: float, ratio: float, last_full: float
) -> float:
    """Return the damping after a step of which a share `length` was taken.

    `ratio` is the actual decrease of the merit over the predicted one, `last_full` the damping of
    the last step that was taken in full, to which the damping returns after one that was not.
    """
    factor = settings.damping_factor
    if length == 1.0 and ratio < settings.poor_decrease:
        return max(factor * damping, settings.first_damping)
    if length == 1.0:
        return damping / factor if damping > NEGLIGIBLE else 0.0
    return max(factor * damping, last_full) if length < CUT_SHORT else damping


def after_failure(settings: Strategies, damping: float) -> float:
    """Return the damping after a line search that found no decrease at all: two steps of damping at once."""
    return max(settings.damping_factor**2 * damping, settings.first_damping)
