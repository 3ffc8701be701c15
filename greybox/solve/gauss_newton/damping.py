"""Levenberg-Marquardt damping: how much after each step.

Source: Marquardt (1963), SIAM Journal on Applied Mathematics 11; the ratio of actual and predicted
decrease decides, as in Nocedal and Wright, Numerical Optimization, 2nd ed., section 10.3. Success
does not depend on these numbers: `benchmarks/ablation.py` tried a tenth and ten times each.
"""

FACTOR = 10.0  # by which the damping grows and falls
FIRST_DAMPING = (
    1e-2  # after a poor step or a failed line search, relative to the Hessian's diagonal
)
LARGEST_DAMPING = 1e6  # beyond which a run has stalled


def next_damping(damping: float, length: float, ratio: float, last_full: float) -> float:
    """Return the damping after a step of which a share `length` was taken.

    `ratio` is the actual decrease of the merit function over the predicted one. `last_full` is the
    damping of the last full step: a step that was cut short is damped at least as much.
    """
    if length == 1.0 and ratio < 0.25:
        return max(FACTOR * damping, FIRST_DAMPING)
    if length == 1.0:
        # Damping below 1e-12 of the diagonal could hold back nothing but rounding.
        return damping / FACTOR if damping > 1e-12 else 0.0
    return max(FACTOR * damping, last_full) if length < 0.2 else damping


def after_failure(damping: float) -> float:
    """Return the damping after a line search without any decrease: grown by two factors at once."""
    return max(FACTOR**2 * damping, FIRST_DAMPING)
