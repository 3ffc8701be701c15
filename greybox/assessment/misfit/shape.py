"""The shape of the term that is missing most: how it depends on a signal."""

from collections.abc import Sequence

import numpy as np

from greybox.assessment.misfit.answer import NAMED, Cause, Shape
from greybox.assessment.misfit.group import Group
from greybox.assessment.misfit.ranking import Tested
from greybox.assessment.misfit.term import KNOTS
from greybox.statistics.column_space import outside

# Share of the largest singular value of the effects of knots, below which samples are too few.
DETERMINED = 0.02


def shape_of(group: Group, tests: Sequence[Tested], causes: Sequence[Cause]) -> Shape | None:
    """Return the shape of the best term over the signal that explains most of the residuals."""
    # A wrong value has no shape, and one that a single record needs has no place in the others; the
    # next best term shows what it imitates.
    drawn = [
        (test, cause)
        for test, cause in zip(tests, causes, strict=True)
        if cause.p_value < NAMED
        and test.candidate.term.has_shape
        and None not in test.candidate.by_part
    ]
    by_part = [part.signals() for part in group.parts]
    if not drawn or not by_part[0]:
        return None

    test, cause = max(drawn, key=lambda pair: pair[1].share)
    best, least = None, np.inf
    for name in by_part[0]:
        at, hats = test.candidate.on_knots([signals[name] for signals in by_part], KNOTS)
        # What the parameters explain is determined neither here nor in the shape of the term, nor
        # are knots with too few samples.
        both = np.hstack([group.columns([hats]), cause.value * test.column])
        effects = outside(group.white(both), group.basis)
        inverse = np.linalg.pinv(effects[:, :-1], rcond=DETERMINED)
        values = inverse @ group.white_residuals
        size = float(np.std(group.white_residuals - effects[:, :-1] @ values))
        if size < least:
            errors = size * np.linalg.norm(inverse, axis=1)
            by_term = inverse @ effects[:, -1]
            rows = (np.ravel(row).tolist() for row in (at, values, errors, by_term))
            best, least = Shape(cause.text, name, *map(tuple, rows)), size
    return best
