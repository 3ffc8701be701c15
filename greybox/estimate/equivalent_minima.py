"""Parameter vectors of one response: lags that change places, signs that change together, and what would choose one."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.files.arrays import Array, BoolArray
from greybox.files.text_table import listed, number, text_table
from greybox.solve.minima import Multistart

APART = 0.05  # of a parameter's size, from which two vectors are clearly different, as in `Minimum.variants`
SAME = 1e-6  # relative difference of two responses of one formula with its parameters exchanged: rounding
MOST = 4  # vectors that are shown; `Fit.equivalents` has all
EXCHANGED = 20  # free parameters up to which exchanges are tried: some hundred


def equivalent_estimates(nlp: CompiledProblem, search: Multistart) -> Array:
    """Return the clearly different parameter vectors (v, p) that give the best response, the best run's first.

    Those at which runs ended; and, of frequency responses, those that exchange two parameters of
    one unit or change one or two signs, if the response stays what it is.
    """
    best = search.minima[0]
    found = [best.estimate]
    left = search.runs.estimate[np.array(best.runs)]
    while (left := left[_apart(left, found[-1]).any(axis=1)]).size:
        found.append(left[0])
    if len(nlp.free) <= EXCHANGED and not any(part.has_states for part in nlp.parts):
        for image in _images(nlp, best.estimate):
            if _is_new(image, found):
                found.append(image)
    return np.array(found)


def _is_new(vector: Array, found: Sequence[Array]) -> bool:
    return all(_apart(vector, other).any() for other in found)


def _apart(a: Array, b: Array) -> BoolArray:
    """Tell which parameters (..., p) are clearly different."""
    return np.abs(a - b) > APART * np.maximum(np.abs(a), np.abs(b)) + 1e-9


def _images(nlp: CompiledProblem, x: Array) -> Iterator[Array]:
    """Yield what an exchange or a change of signs makes of x (p,) where that changes no response."""
    units = [nlp.problem.parameters[name].unit for name in nlp.free]
    p = len(x)
    images = []
    for i, j in combinations(range(p), 2):
        if units[i] == units[j]:
            order = np.arange(p)
            order[[i, j]] = j, i
            images.append(x[order])
    for count in (1, 2):
        for group in combinations(np.flatnonzero(x).tolist(), count):
            signs = np.ones(p)
            signs[list(group)] = -1
            images.append(signs * x)
    inside = [
        z for z in images if np.all((z >= nlp.lower) & (z <= nlp.upper)) and _apart(z, x).any()
    ]
    if not inside:
        return
    signatures = nlp.signatures(np.array([x, *inside]))
    away = np.sqrt(np.mean((signatures[1:] - signatures[0]) ** 2, axis=1)) / max(
        np.sqrt(np.mean(signatures[0] ** 2)), 1e-300
    )
    for image, distance in zip(inside, away, strict=True):
        if distance <= SAME and np.all(np.asarray(nlp.constraint(nlp.all_values(image))) >= 0):
            yield image


def relation(names: Sequence[str], best: Array, other: Array) -> tuple[str, str]:
    """Return how two vectors (p,) of one response are related, in words, and what must be >= 0 to keep the first.

    Both are empty where no exchange and no change of signs makes one of the other.
    """
    places = np.flatnonzero(_apart(best, other)).tolist()
    if places and not any(_apart(best[places], -other[places])):
        changed = [names[k] for k in places]
        words = f"{listed(changed)} {'changes its sign' if len(changed) == 1 else 'change their signs together'}"
        largest = max(places, key=lambda k: (bool(best[k] > 0), abs(best[k])))
        return words, f"{'' if best[largest] > 0 else '-'}p.{names[largest]}"
    pairs = []
    left = list(places)
    while left:
        i = left.pop(0)
        match = next((j for j in left if not _apart(best[[i, j]], other[[j, i]]).any()), None)
        if match is None:
            return "", ""
        left.remove(match)
        pairs.append((i, match))
    if not pairs:
        return "", ""
    joint = " and " if len(pairs) == 1 else " with "
    words = listed([f"{names[i]}{joint}{names[j]}" for i, j in pairs]) + " change places"
    # The pair that lies farthest apart orders most clearly.
    i, j = max(
        pairs, key=lambda pair: abs(best[pair[0]] - best[pair[1]]) / np.abs(best[list(pair)]).max()
    )
    high, low = (i, j) if best[i] > best[j] else (j, i)
    return words, f"p.{names[high]} - p.{names[low]}"


def said(names: Sequence[str], vectors: Array) -> str:
    """Return the sentence about vectors (v, p) of one response, and a table of what differs between them."""
    best, others = vectors[0], vectors[1:]
    relations = [relation(names, best, other) for other in others]
    words = list(dict.fromkeys(text for text, _ in relations if text))
    keep = list(dict.fromkeys(condition for _, condition in relations if condition))
    what = f", since {' and '.join(words)}" if words and all(text for text, _ in relations) else ""
    cure = (
        f"constraints=[{', '.join(f'lambda p: {condition}' for condition in keep)}] keeps the one given here"
        if what
        else "add an ordering constraint or fix a parameter to choose one of them"
    )
    differing = [k for k in range(len(names)) if any(_apart(best, other)[k] for other in others)]
    rows = [[names[k], *(number(vector[k]) for vector in vectors[:MOST])] for k in differing]
    head = ["", "given here", *(f"also {k}" for k in range(1, min(len(vectors), MOST)))]
    table = "\n".join("    " + line for line in text_table(head, rows).splitlines())
    return f"at least {len(vectors)} clearly different parameter vectors give this same response{what}: {cure}.\n{table}"
