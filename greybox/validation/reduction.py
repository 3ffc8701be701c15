"""The smaller structure that a fit suggests: parameters that its data leave open go to a limit.

Where the data determine only ratios or products of parameters, their members can move together
without a change of the cost. The two ends of that direction are structures with one parameter less:
a₂ → ∞ with a₁/a₂ and a₃/a₂ kept. A parameter that the data do not determine has two ends of its own.
`reduce` fits every end at which the response has a limit, takes the best one that no test rejects,
and asks again.

Source: Transtrum and Qiu (2014), Model reduction by manifold boundaries, Physical Review Letters
113.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import AnyProblem
from greybox.estimate.fit import fit as fit_problem
from greybox.estimate.fitted_problem import problem_of
from greybox.estimate.identifiability import ERROR_GUIDELINE
from greybox.estimate.result import Fit
from greybox.files.text_table import counted, number, one_line, text_table
from greybox.formulation.problem import Problem
from greybox.formulation.starts import Sobol
from greybox.modeling.limit import Limit, invariant_name
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.transfer_function import TransferFunction
from greybox.validation.comparison import SIGNIFICANT, p_text
from greybox.validation.nested_models import NestedTest, ratio_test


@dataclass(frozen=True)
class Candidate:
    """One end of a direction that the data leave open.

    Attributes
    ----------
    powers : mapping of name to int
        The parameters that move together, as powers of the first one.
    end : "infinity" or "zero"
        Where the first one goes.
    """

    powers: Mapping[str, int]
    end: str

    def __str__(self) -> str:
        name, *members = self.powers
        ends = "→ ∞" if self.end == "infinity" else "→ 0" if members else "= 0"
        invariants = []
        for member in members:
            power = self.powers[member]
            exponent = "" if abs(power) == 1 else f"^{abs(power)}"
            invariants.append(f"{member}{'/' if power > 0 else '·'}{name}{exponent}")
        text = f"{name} {ends}"
        return f"{text}, {' and '.join(invariants)} kept" if invariants else text


@dataclass(frozen=True)
class Tried:
    """A candidate with its fit and its test, both None where no start converged."""

    candidate: Candidate
    fit: Fit | None
    test: NestedTest | None
    taken: bool = False

    @property
    def is_supported(self) -> bool:
        """Whether the test does not reject it."""
        return self.test is not None and self.test.p_value >= SIGNIFICANT


@dataclass(frozen=True, eq=False)
class Reduction:
    """A fit and the smaller structure that its data support as well. Printing it gives the verdict.

    Attributes
    ----------
    large, fit : Fit
        The fit that was reduced, and that of the smaller structure; the same where there is none.
    tried : tuple of Tried
        The limits that were fitted, in this order.
    test : NestedTest or None
        The test of the smaller structure against the large one.
    """

    large: Fit
    fit: Fit
    tried: tuple[Tried, ...]
    test: NestedTest | None

    @property
    def taken(self) -> tuple[Candidate, ...]:
        """The limits that were taken, in this order."""
        return tuple(trial.candidate for trial in self.tried if trial.taken)

    @property
    def verdict(self) -> str:
        """The smaller structure, or why there is none, in one sentence."""
        if not self.tried:
            return f"{self.large.name}: not reduced; no parameter that the data leave open has a limit."
        if not self.taken:
            return f"{self.large.name}: not reduced; the data reject every limit at 5 %."
        return (
            f"{self.large.name}: {counted(len(self.fit.free), 'parameter')} instead of "
            f"{len(self.large.free)}, cost {number(self.fit.cost, 4)} against "
            f"{number(self.large.cost, 4)}: {'; '.join(map(str, self.taken))}."
        )

    def __repr__(self) -> str:
        return one_line(self, self.large.name, "; ".join(map(str, self.taken)) or "not reduced")

    def __str__(self) -> str:
        rows = []
        for trial in self.tried:
            cells = ["-", "-", "no fit"]
            if trial.fit is not None and trial.test is not None:
                outcome = "taken" if trial.taken else "" if trial.is_supported else "rejected"
                cells = [number(trial.fit.cost), p_text(trial.test.p_value), outcome]
            rows.append([str(trial.candidate), *cells])
        table = text_table(["limit", "cost", "test", ""], rows, left=(0, 3))
        lines = [self.verdict, *(["", table] if rows else [])]
        lines += ["", str(self.test), "", str(self.fit)] if self.test else []
        return "\n".join(lines)


def reduce(fit: Fit, *, problem: AnyProblem | None = None, starts: int = 8) -> Reduction:
    """Fit the smaller structure that the determined combinations suggest, and compare it.

    A structure is taken where the ratio of the costs does not reject it at 5 %, and of several the
    one with the lowest cost. At a limit the ratio tends to be smaller than its distribution, so the
    p-value is an upper limit.

    Parameters
    ----------
    fit : Fit
        Of transfer functions to frequency responses.
    problem : Problem or Sum, optional
        The problem that was fitted; needed where it has ties, constraints, or values fixed by an
        earlier fit.
    starts : int
        Sobol points from which every candidate is fitted, beside the estimate.

    Raises
    ------
    ValueError
        For a fit without an estimate, of other models or data, with a-priori knowledge, or whose
        problem cannot be stated again.
    """
    if not fit.converged:
        raise ValueError(f"the fit {fit.name!r} has no estimate to reduce: {fit.status}.")
    current = problem_of(fit) if problem is None else problem
    if set(_free(current)) != set(fit.free):
        raise ValueError(
            f"problem {current.name!r} has other unknowns than the fit: give the one fitted."
        )
    if len(fit.responses) < len(fit.parts) or not all(
        isinstance(part.model, TransferFunction) for part in current.parts
    ):
        raise ValueError(
            f"{fit.name!r} can only be reduced as transfer functions fitted to frequency responses: "
            "write the equations of the limit, fit them and compare."
        )

    tried: list[Tried] = []
    reduced = fit
    while trials := _trials(reduced, current, starts):
        supported = [(t, smaller) for t, smaller in trials if t.is_supported]
        best, smaller = min(supported, key=lambda pair: _cost(pair[0]), default=(None, current))
        tried += [replace(t, taken=t is best) for t, _ in trials]
        if best is None or best.fit is None:
            break
        reduced = best.fit
        current = smaller
    if reduced is fit:
        return Reduction(fit, fit, tuple(tried), None)
    removed = tuple(next(iter(t.candidate.powers)) for t in tried if t.taken)
    test = ratio_test(reduced, fit, removed, ("the reduced structure", "the fit"))
    return Reduction(fit, reduced, tuple(tried), test)


def _trials(fit: Fit, problem: AnyProblem, starts: int) -> list[tuple[Tried, AnyProblem]]:
    """Return the fits of all limits that the estimate leaves open, with their problems."""
    trials = []
    for candidate in _candidates(fit):
        smaller = _at_limit(problem, candidate, fit)
        if smaller is None or not _has_limit(smaller, problem, fit):
            continue
        start = {name: value for name, value in fit.estimate.items() if name in _free(smaller)}
        reduced = fit_problem(smaller, [start, Sobol(starts, 0)], profiles=False, progress=False)
        trial = Tried(candidate, None, None)
        if reduced.converged:
            first = tuple(candidate.powers)[:1]
            test = ratio_test(reduced, fit, first, ("the limit", "the structure"))
            trial = Tried(candidate, reduced, test)
        trials.append((trial, smaller))
    return trials


def _cost(trial: Tried) -> float:
    return np.inf if trial.fit is None else trial.fit.cost


def _free(problem: AnyProblem) -> list[str]:
    return [name for name, p in problem.parameters.items() if not p.fixed]


def _candidates(fit: Fit) -> Iterator[Candidate]:
    """Yield both ends of every direction that keeps determined products, and of open parameters.

    A parameter at a bound is open too: nothing but the bound holds it.
    """
    judged = fit.identifiability
    products = [
        dict(zip(c.names, c.powers, strict=True)) for c in judged.combinations if c.is_product
    ]
    for direction in directions(products):
        for end in ("infinity", "zero"):
            yield Candidate(direction, end)
    for name, error in zip(judged.names, judged.error, strict=True):
        is_open = not error <= ERROR_GUIDELINE or name in judged.at_bound
        if is_open and fit.estimate[name] != 0:
            for end in ("zero", "infinity"):
                yield Candidate({name: 1}, end)


def directions(products: Sequence[Mapping[str, int]]) -> Iterator[dict[str, int]]:
    """Yield the whole powers of the first member by which products stay as they are."""
    # The member of most products reads best as what the others are divided by.
    members = sorted(
        dict.fromkeys(name for product in products for name in product),
        key=lambda name: -sum(name in product for product in products),
    )
    matrix = np.array([[product.get(name, 0) for name in members] for product in products])
    if not members or np.linalg.matrix_rank(matrix) != len(members) - 1:
        return  # no direction, or several that are not told apart
    vector = np.linalg.svd(matrix)[2][-1].round(9)
    moving = [k for k, v in enumerate(vector) if v]
    pivot = min(moving, key=lambda k: abs(vector[k]))
    powers = vector / vector[pivot]
    if np.allclose(powers, np.round(powers), atol=1e-6):
        order = [pivot, *(k for k in moving if k != pivot)]
        yield {members[k]: round(powers[k]) for k in order}


def _at_limit(problem: AnyProblem, candidate: Candidate, fit: Fit) -> AnyProblem | None:
    """Return the problem at a limit; None where a part cannot have it, as one with a tie."""
    try:
        parts = [_part_at_limit(part, candidate, fit) for part in problem.parts]
        return problem.with_parts(parts)
    except ValueError:
        return None


def _part_at_limit(part: Problem, candidate: Candidate, fit: Fit) -> Problem:
    """Return a part at a limit, unchanged if it has none of the parameters.

    Raises
    ------
    ValueError
        If it has some of the parameters, but not the first one.
    """
    inside = {part.outside(name): name for name in part.declared}
    present = [name for name in candidate.powers if name in inside]
    if not present:
        return part
    first = next(iter(candidate.powers))
    if first not in present:
        raise ValueError(f"{part.name!r} has no parameter {first!r}.")
    model: Any = part.model  # a transfer function, as `reduce` requires
    removed_names = {inside[name] for name in present}
    invariants = []
    rename = {name: outside for name, outside in part.rename.items() if name not in removed_names}
    for name in present[1:]:
        power = candidate.powers[name]
        invariants.append((inside[name], power, fit.estimate[name]))
        invariant = invariant_name(inside[name], inside[first], power)
        outside = invariant_name(name, first, power)
        if invariant != outside:
            rename[invariant] = outside
    return part.with_(
        model=Limit(model, inside[first], fit.estimate[first], candidate.end, invariants),
        rename=rename,
        free=[name for name in part.free if name not in removed_names],
        bounds={name: value for name, value in part.bounds.items() if name not in removed_names},
        starts={name: value for name, value in part.starts.items() if name not in removed_names},
    )


def _has_limit(problem: AnyProblem, before: AnyProblem, fit: Fit) -> bool:
    """Tell whether every response has a finite limit that is not zero at the data's frequencies."""
    for part, previous in zip(problem.parts, before.parts, strict=True):
        model = part.model
        if model is previous.model or not isinstance(model, Limit):
            continue
        p = {
            name: fit.estimate.get(part.outside(name), parameter.start)
            for name, parameter in model.parameters.items()
        }
        responses = []
        for value in (model.value, model.value * (10 if model.end == "infinity" else 0.1)):
            try:
                with np.errstate(all="ignore"):
                    values = model.values_before(p, value)
                    omega = part.response.omega
                    responses.append(frequency_response(model.model, values, omega).response)
            except (ValueError, ArithmeticError):
                return False
        near, nearer = responses
        # 1e-6: a hundred times what `Limit` leaves out.
        moves = np.abs(near - nearer) > 1e-6 * np.abs(near)
        vanishes = np.abs(near) < 1e-6 * np.abs(part.response.response)
        if not np.all(np.isfinite(near)) or np.any(moves) or np.all(vanishes):
            return False
    return True
