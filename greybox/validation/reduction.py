"""The smaller structure that a fit suggests: what its data do not determine goes to zero or infinity.

Where the data determine combinations of parameters and not their members, the members can move
together along a direction that leaves the combinations as they are, and nothing tells how far. Its
two ends are structures without that direction: a₂ → ∞ with a₁/a₂ and a₃/a₂ kept. A parameter that
the data do not determine has two ends of its own. Of all ends at which the response of the model
has a limit the fits are compared with that of the larger structure, and the best one that no test
rejects is taken; then the same is asked again.

Source: Transtrum and Qiu (2014), Model reduction by manifold boundaries, Physical Review Letters
113.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import AnyProblem
from greybox.data.record import Record
from greybox.estimate.fit import fit as fit_problem
from greybox.estimate.fitted_problem import problem_of
from greybox.estimate.identifiability import ERROR_GUIDELINE
from greybox.estimate.result import Fit, FittedRecord
from greybox.files.arrays import Array
from greybox.files.text_table import counted, number, one_line, text_table
from greybox.formulation.problem import Problem
from greybox.formulation.starts import Sobol
from greybox.modeling.limit import at_limit, invariant_name
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model
from greybox.modeling.realization import dynamics
from greybox.simulation.simulate import simulate
from greybox.validation.compare import compare
from greybox.validation.comparison import SIGNIFICANT, Comparison, p_text
from greybox.validation.nested_models import NestedTest, ratio_test

# Relative difference of two responses a factor of ten apart on the way to a limit, below which
# there is one: a hundred times what `Limit` leaves out.
ARRIVED = 1e-6

# Times the fastest pole that there was: a limit with a faster one is too stiff for records. The
# limit is 2^26 away.
STIFF = 1e3
STIFF_IN_TIME = "too stiff in time"

Direction = dict[str, int]


@dataclass(frozen=True)
class Candidate:
    """One end of a direction that the data leave open.

    Attributes
    ----------
    powers : mapping of name to int
        The parameters that move together, the first one to its end, and by which power of it each
        of them goes.
    end : "infinity" or "zero"
    """

    powers: Mapping[str, int]
    end: str

    def __str__(self) -> str:
        name, *others = self.powers
        text = (
            f"{name} → ∞" if self.end == "infinity" else f"{name} → 0" if others else f"{name} = 0"
        )
        kept = [
            f"{other}{'/' if self.powers[other] > 0 else '·'}{name}{_exponent(self.powers[other])}"
            for other in others
        ]
        return f"{text}, {' and '.join(kept)} kept" if kept else text


@dataclass(frozen=True)
class Tried:
    """One candidate, with its fit and the test of it, and what was fitted; None where it failed, or why it was not."""

    candidate: Candidate
    fit: Fit | None
    test: NestedTest | None
    taken: bool = False
    problem: AnyProblem | None = None
    why_not: str = ""


@dataclass(frozen=True, eq=False)
class Reduction:
    """A fit and the smaller structures that its data support as well. Printing it says what went where.

    Attributes
    ----------
    large : Fit
        The fit that was reduced.
    fit : Fit
        That of the reduced structure; the same where none was found.
    tried : tuple of Tried
        All ends at which what the model says of the data has a limit, in the order in which they
        were fitted.
    test : NestedTest or None
        Of the reduced structure against the large one.
    comparison : Comparison or None
    """

    large: Fit
    fit: Fit
    tried: tuple[Tried, ...]
    test: NestedTest | None
    comparison: Comparison | None

    @property
    def taken(self) -> tuple[Candidate, ...]:
        """What went to its limit, in this order."""
        return tuple(one.candidate for one in self.tried if one.taken)

    def __repr__(self) -> str:
        return one_line(self, self.large.name, "; ".join(map(str, self.taken)) or "not reduced")

    def __str__(self) -> str:
        lines = [self._title, ""]
        rows = []
        for one in self.tried:
            failed = one.fit is None or one.test is None
            cells = ["-", "-"] if failed else [number(one.fit.cost), p_text(one.test.p_value)]  # type: ignore[union-attr]
            rejected = not failed and one.test.p_value < SIGNIFICANT  # type: ignore[union-attr]
            rows.append(
                [
                    str(one.candidate),
                    *cells,
                    "taken" if one.taken else "rejected" if rejected else one.why_not,
                ]
            )
        if rows:
            table = text_table(["limit", "cost", "test", ""], rows, left=(0, 3))
            lines += [*("  " + line for line in table.splitlines()), ""]
        if self.comparison is not None and self.test is not None:
            lines += [f"  {self.test}", f"  {self.comparison.verdict}", "", str(self.fit)]
        return "\n".join(lines).rstrip()

    @property
    def _title(self) -> str:
        free = len(self.large.free)
        stiff = [str(one.candidate) for one in self.tried if one.why_not]
        if not self.tried:
            return (
                f"{self.large.name}: not reduced; no parameter with an error above {100 * ERROR_GUIDELINE:.0f} % has "
                "an end at which what the model says of the data has a limit."
            )
        if not self.taken:
            rejected = f"the data reject every {'other ' if stiff else ''}limit at {100 * SIGNIFICANT:.0f} %"
            said = [] if len(stiff) == len(self.tried) else [rejected]
            if stiff:
                said.append(
                    f"the equations are too stiff in time for {' or '.join(stiff)}: write those of the limit"
                )
            return f"{self.large.name}: not reduced; {', and '.join(said)}."
        return (
            f"{self.large.name}: {counted(len(self.fit.free), 'parameter')} instead of {free}, cost "
            f"{number(self.fit.cost, 4)} against {number(self.large.cost, 4)}: {'; '.join(map(str, self.taken))}."
        )


def reduce(fit: Fit, *, problem: AnyProblem | None = None, starts: int = 8) -> Reduction:
    """Fit the smaller structure that the determined combinations suggest, and compare it with the fit.

    Parameters
    ----------
    fit : Fit
        Of frequency responses, of records, or of both. In time a limit with poles far above those
        of the structure is told and not fitted: it asks for other equations.
    problem : Problem or Sum, optional
        What was fitted; needed where it has ties, constraints, or values fixed by an earlier fit.
    starts : int
        Sobol points from which every candidate is fitted, beside the estimate.

    Returns
    -------
    Reduction
        A structure is taken where the ratio of the costs does not reject it at 5 %, and of several
        the one with the lowest cost. At the end of a range the ratio tends to be smaller than its
        distribution says, so the p-value is an upper limit.

    Raises
    ------
    ValueError
        For a fit without an estimate, with manoeuvres or a-priori knowledge, or whose problem
        cannot be stated again.
    """
    if not fit.converged:
        raise ValueError(f"the fit {fit.name!r} has no estimate to reduce: {fit.status}.")
    if fit.spectra or fit.priors:
        what = "manoeuvres" if fit.spectra else "a-priori knowledge"
        raise ValueError(
            f"the fit {fit.name!r} has {what}, with which nothing is reduced: fix parameters instead."
        )
    stated = problem_of(fit) if problem is None else problem
    if set(_free(stated)) != set(fit.free):
        raise ValueError(
            f"problem {stated.name!r} has other unknowns than the fit: give the one fitted."
        )

    tried: list[Tried] = []
    current = fit
    while found := _step(current, stated, starts):
        best = min((one for one in found if _is_supported(one)), key=_cost, default=None)
        tried += [replace(one, taken=one is best) for one in found]
        if best is None or best.fit is None or best.problem is None:
            break
        current, stated = best.fit, best.problem
    if current is fit:
        return Reduction(fit, fit, tuple(tried), None, None)
    labels = ("the fit", "the reduced one")
    removed = tuple(next(iter(one.candidate.powers)) for one in tried if one.taken)
    return Reduction(
        large=fit,
        fit=current,
        tried=tuple(tried),
        test=ratio_test(current, fit, removed, ("the reduced structure", "the fit")),
        comparison=compare(fit, current, labels=labels),
    )


def _step(fit: Fit, problem: AnyProblem, starts: int) -> list[Tried]:
    """Return the fits of all ends that the estimate leaves open."""
    found = []
    for candidate in _candidates(fit):
        smaller = _at_limit(problem, candidate, fit)
        if smaller is None:
            continue
        if _is_stiff(smaller, problem, fit):
            found.append(Tried(candidate, None, None, why_not=STIFF_IN_TIME))
            continue
        if not _has_limit(smaller, problem, fit):
            continue
        known = {name: value for name, value in fit.estimate.items() if name in _free(smaller)}
        reduced = fit_problem(smaller, [known, Sobol(starts, 0)], profiles=False, progress=False)
        if not reduced.converged:
            found.append(Tried(candidate, None, None))
            continue
        gone = tuple(candidate.powers)[:1]
        test = ratio_test(reduced, fit, gone, ("the limit", "the structure"))
        found.append(Tried(candidate, reduced, test, problem=smaller))
    return found


def _is_supported(tried: Tried) -> bool:
    return tried.test is not None and tried.test.p_value >= SIGNIFICANT


def _cost(tried: Tried) -> float:
    return math.inf if tried.fit is None else tried.fit.cost


def _free(problem: AnyProblem) -> dict[str, Any]:
    return {name: p for name, p in problem.parameters.items() if not p.fixed}


# --- directions


def _candidates(fit: Fit) -> Iterator[Candidate]:
    """Yield both ends of every direction that leaves the determined products as they are, and of every open parameter.

    Parameters at a bound are open too: nothing but the bound holds them.
    """
    judged = fit.identifiability
    at_bound = set(judged.at_bound)
    is_open = [
        name
        for name, error in zip(judged.names, judged.error, strict=True)
        if (not error <= ERROR_GUIDELINE or name in at_bound) and fit.estimate[name] != 0
    ]
    products = [
        dict(zip(c.names, c.powers, strict=True)) for c in judged.combinations if c.is_product
    ]
    for direction in _directions(products):
        for end in ("infinity", "zero"):
            yield Candidate(direction, end)
    for name in is_open:
        for end in ("zero", "infinity"):
            yield Candidate({name: 1}, end)


def _directions(products: Sequence[Direction]) -> Iterator[Direction]:
    """Yield whole powers by which the members of products move and leave all products as they are.

    The first of a direction moves by the power one: the one that all others are whole powers of.
    """
    members = list(dict.fromkeys(name for row in products for name in row))
    for vector in _null_space(
        [[row.get(name, 0) for name in members] for row in products], len(members)
    ):
        moving = [k for k, v in enumerate(vector) if v]
        # Of several that would do, the one that most products have reads best as what the others
        # are divided by.
        pivot = min(
            moving, key=lambda k: (abs(vector[k]), -sum(members[k] in row for row in products))
        )
        if any((v / vector[pivot]).denominator > 1 for v in vector):
            continue
        powers = {
            name: int(v / vector[pivot]) for name, v in zip(members, vector, strict=True) if v
        }
        yield {
            members[pivot]: 1,
            **{name: p for name, p in powers.items() if name != members[pivot]},
        }


def _null_space(rows: Sequence[Sequence[int]], width: int) -> list[list[Fraction]]:
    """Return a basis of the vectors that all rows are orthogonal to, in exact fractions."""
    matrix = [[Fraction(v) for v in row] for row in rows]
    pivots: list[int] = []
    for column in range(width):
        rank = len(pivots)
        row = next((r for r in range(rank, len(matrix)) if matrix[r][column]), None)
        if row is None:
            continue
        matrix[rank], matrix[row] = matrix[row], matrix[rank]
        matrix[rank] = [v / matrix[rank][column] for v in matrix[rank]]
        for r in range(len(matrix)):
            if r != rank and matrix[r][column]:
                factor = matrix[r][column]
                matrix[r] = [a - factor * b for a, b in zip(matrix[r], matrix[rank], strict=True)]
        pivots.append(column)
    basis = []
    for free in (k for k in range(width) if k not in pivots):
        vector = [Fraction(0)] * width
        vector[free] = Fraction(1)
        for row, column in enumerate(pivots):
            vector[column] = -matrix[row][free]
        basis.append(vector)
    return basis


# --- problems at a limit


def _at_limit(problem: AnyProblem, candidate: Candidate, fit: Fit) -> AnyProblem | None:
    """Return the problem at an end; None where it has no form there, as where a tie names a parameter that is gone."""
    try:
        parts = [_part_at_limit(part, candidate, fit) for part in problem.parts]
        stated = [part for part in parts if part is not None]
        return problem.with_parts(stated) if len(stated) == len(parts) else None
    except ValueError:
        return None


def _part_at_limit(part: Problem, candidate: Candidate, fit: Fit) -> Problem | None:
    inside = {part.outside(name): name for name in part.declared}
    present = [name for name in candidate.powers if name in inside]
    if not present:
        return part
    first = next(iter(candidate.powers))
    others = [name for name in present if name != first]
    gone = {inside[name] for name in present}
    if first not in present or not gone <= set(
        part.model.parameters
    ):  # a bias of a sensor, or a gain
        return None
    kept = [(inside[name], candidate.powers[name], fit.estimate[name]) for name in others]
    model = at_limit(part.model, inside[first], fit.estimate[first], candidate.end, kept)
    rename = {name: outside for name, outside in part.rename.items() if name not in gone}
    for name in others:
        power = candidate.powers[name]
        new, outside = (
            invariant_name(inside[name], inside[first], power),
            invariant_name(name, first, power),
        )
        if new != outside:
            rename[new] = outside
    bounds, box = (
        {n: v for n, v in stated.items() if n not in gone} for stated in (part.bounds, part.starts)
    )
    free = [name for name in part.free if name not in gone]
    return part.with_(model=model, rename=rename, free=free, bounds=bounds, starts=box)


def _has_limit(problem: AnyProblem, before: AnyProblem, fit: Fit) -> bool:
    """Tell whether what the model says of its data has a finite limit that is not zero, in every part."""
    for k, (part, old) in enumerate(zip(problem.parts, before.parts, strict=True)):
        if part.model is old.model:
            continue
        model: Any = part.model
        p = _values(part, fit)
        near = [
            _said(old, model.values_before(p, value), fit, k)
            for value in (model.value, model.value * (10 if model.end == "infinity" else 0.1))
        ]
        if not all(np.all(np.isfinite(r)) for r in near):
            return False
        size, measured = np.abs(near[0]), _measured(part, fit, k)
        if isinstance(part.data, Record):  # whose outputs pass through zero
            size = np.broadcast_to(size.max(axis=-1, keepdims=True), size.shape)
        if np.any(np.abs(near[0] - near[1]) > ARRIVED * size) or np.all(size < ARRIVED * measured):
            return False
    return True


def _measured(part: Problem, fit: Fit, k: int) -> Array:
    """Return the size of what was measured: of every point of a response (n,), of every output (outputs, 1)."""
    if not isinstance(part.data, Record):
        return np.abs(part.response.response)
    return np.array([[np.nanmax(np.abs(part.data[name]))] for name in _record(fit, k).outputs])


def _record(fit: Fit, k: int) -> FittedRecord:
    part = fit.parts[k]
    assert isinstance(part, FittedRecord)
    return part


def _values(part: Problem, fit: Fit) -> dict[str, float]:
    """Return the values of the model's parameters at the estimate, as far as it has them."""
    return {
        name: fit.estimate.get(part.outside(name), parameter.start)
        for name, parameter in part.model.parameters.items()
    }


def _said(part: Problem, values: Mapping[str, float], fit: Fit, k: int) -> NDArray[Any]:
    """Return what the model says of the data of a part: a response (n,), or outputs (outputs, n); NaN if nothing.

    Records are simulated from the initial states of the fit.
    """
    with np.errstate(all="ignore"):
        try:
            if isinstance(part.data, Record):
                record, inputs = _record(fit, k), getattr(part.criterion, "inputs", None)
                found = simulate(
                    part.model, values, part.data, initial=record.initial, inputs=inputs
                )
                return np.array([found[name] for name in record.outputs])
            pair = {"input": part.response.input, "output": part.response.output}
            return frequency_response(
                part.model, values, part.response.omega, **pair, at=part.at
            ).response
        except (ValueError, ArithmeticError):
            return np.full(1, np.nan)


def _is_stiff(problem: AnyProblem, before: AnyProblem, fit: Fit) -> bool:
    """Tell whether the limit has poles far above those that there were, in a part that is a record."""
    for k, (part, old) in enumerate(zip(problem.parts, before.parts, strict=True)):
        if not isinstance(part.data, Record) or part.model is old.model:
            continue
        poles = [
            _fastest(each.model, _values(each, fit), _record(fit, k).initial)
            for each in (part, old)
        ]
        if not poles[0] <= STIFF * poles[1]:
            return True
    return False


def _fastest(model: Model, values: Mapping[str, float], initial: Mapping[str, Array]) -> float:
    """Return the largest |pole| about the first initial state, with the inputs at rest."""
    system = dynamics(model)
    x, u = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs))
    slope = ca.jacobian(system.derivative(x, u, [values[name] for name in system.parameters]), x)
    state = [float(initial[name][0]) if name in initial else 0.0 for name in system.states]
    matrix = ca.Function("A", [x, u], [ca.densify(slope)])(
        state, np.zeros(len(system.inputs))
    ).full()
    if not np.all(np.isfinite(matrix)):
        return math.inf
    return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0)) if matrix.size else 0.0


def _exponent(power: int) -> str:
    return {1: "", 2: "²", 3: "³"}.get(abs(power), f"^{abs(power)}")
