"""Different parameter vectors that give the same response, such as two lags that swap."""

from collections.abc import Sequence

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.files.arrays import Array, BoolArray
from greybox.files.text_table import number, text_table
from greybox.solve.minima import Multistart

SHOWN = 4  # vectors in the table


def equivalent_estimates(nlp: CompiledProblem, search: Multistart) -> Array:
    """Return the clearly different vectors (v, p) at which runs reached the best response, the best run's first."""
    best = search.minima[0]
    vectors = [best.estimate]
    remaining = search.runs.estimate[np.array(best.runs)]
    while (remaining := remaining[_differ(remaining, vectors[-1]).any(axis=1)]).size:
        vectors.append(remaining[0])
    return np.array(vectors)


def _differ(a: Array, b: Array) -> BoolArray:
    """Return which parameters (..., p) differ by more than 5 % of their size, as in `Minimum.variants`."""
    return np.abs(a - b) > 0.05 * np.maximum(np.abs(a), np.abs(b)) + 1e-9


def equivalents_warning(names: Sequence[str], vectors: Array) -> str:
    """Return the sentence about vectors (v, p) of one response, and a table of their differences."""
    best = vectors[0]
    differing = np.flatnonzero(_differ(vectors, best).any(axis=0)).tolist()
    rows = [[names[k], *(number(vector[k]) for vector in vectors[:SHOWN])] for k in differing]
    head = ["", "reported", *(f"also {k}" for k in range(1, min(len(vectors), SHOWN)))]
    table = "\n".join("    " + line for line in text_table(head, rows).splitlines())
    return (
        f"at least {len(vectors)} clearly different parameter vectors give this same response: add an ordering "
        f"constraint, such as constraints=[lambda p: p.T1 - p.T2], or fix a parameter to choose one of them.\n{table}"
    )
