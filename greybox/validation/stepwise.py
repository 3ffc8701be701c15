"""Terms of a model chosen from a list of candidates: added and removed one at a time, by a test.

A term is a parameter, and the model is without it where that parameter is zero (or another stated
value). From the structure without any candidate, the term whose ratio of costs is the least likely
by chance is added, if it is significant at the stated size shared by all that were tried; after
that, terms that are no longer needed are removed. What the data cannot tell apart is looked for at
the end, by putting each term that was left out in the place of each one that was chosen.

What a term that is missing leaves in the residuals of a response looks like errors that are
correlated along frequency: the tests take errors as independent, or they would find all of it in
the errors. The standard errors of the fit that is chosen do not.

Source: Klein and Morelli (2006), Aircraft System Identification, section 5.4; the shares of the
size are Bonferroni's.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from greybox.compiled.compiled_problem import AnyProblem
from greybox.estimate.fit import fit as fit_problem
from greybox.estimate.result import Fit
from greybox.files.text_table import counted, listed, number, one_line, text_table
from greybox.formulation.problem import Problem
from greybox.formulation.starts import Sobol
from greybox.modeling.model import require_known
from greybox.validation.comparison import SIGNIFICANT, p_text
from greybox.validation.nested_models import cost_scale, nested_test, with_independent_errors
from greybox.validation.significance import EQUAL_AIC

Terms = frozenset[str]


@dataclass(frozen=True)
class Trial:
    """One change that was tried.

    Attributes
    ----------
    step : int
    change : "add" or "remove"
    term : str
    cost : float
        With the change; NaN where no fit converged.
    p_value : float
        Of the term; NaN where it could not be tested.
    limit : float
        Below which it is added, above which it is removed.
    done : bool
    why_not : str
        Why there is no test.
    """

    step: int
    change: str
    term: str
    cost: float
    p_value: float
    limit: float
    done: bool = False
    why_not: str = ""


@dataclass(frozen=True, eq=False)
class StepwiseSelection:
    """The terms that the data support. Printing it shows every step.

    Attributes
    ----------
    candidates, terms : tuple of str
        What could be chosen, and what was.
    fit, without : Fit
        With these terms, and without any candidate.
    trials : tuple of Trial
    alike : mapping of str to mapping of str to float
        For each chosen term those that could stand in its place, by how much AIC is larger with
        them: less than 2, so that the data do not tell them apart.
    size : float
        Of the test.
    """

    candidates: tuple[str, ...]
    terms: tuple[str, ...]
    fit: Fit
    without: Fit
    trials: tuple[Trial, ...]
    alike: Mapping[str, Mapping[str, float]]
    size: float

    @property
    def verdict(self) -> str:
        """What was found, in one sentence."""
        tried = counted(len(self.candidates), "candidate")
        if not self.terms:
            return f"None of {tried} is supported: no term lowers the cost by more than chance."
        text = (
            f"{listed(self.terms)} of {tried} {'is' if len(self.terms) == 1 else 'are'} supported"
        )
        return f"{text}: cost {number(self.fit.cost, 4)} instead of {number(self.without.cost, 4)} without."

    def __repr__(self) -> str:
        return one_line(self, self.fit.name, ", ".join(self.terms) or "no term")

    def __str__(self) -> str:
        rows = []
        for trial in self.trials:
            p = trial.why_not or p_text(trial.p_value).removeprefix("p = ").removeprefix("p ")
            done = {"add": "added", "remove": "removed"}[trial.change] if trial.done else ""
            rows.append(
                [
                    str(trial.step),
                    trial.change,
                    trial.term,
                    number(trial.cost, 4),
                    p,
                    f"{trial.limit:.2g}",
                    done,
                ]
            )
        table = text_table(["step", "", "term", "cost", "p", "limit", ""], rows, left=(1, 2, 6))
        lines = [
            f"{self.fit.name}: stepwise selection at {100 * self.size:g} %",
            "",
            f"  {self.verdict}",
            "",
        ]
        lines += [f"  {line}" for line in table.splitlines()]
        lines += ["", *(f"  {text}" for text in self._notes())]
        return "\n".join(lines).rstrip()

    def _notes(self) -> Iterator[str]:
        for term, others in self.alike.items():
            said = listed([f"{other} ({_more(above)})" for other, above in others.items()])
            yield f"These data cannot tell {term} from {said}."
        for one, other, r in self.fit.identifiability.correlated:
            if {one, other} & set(self.terms):
                yield f"{one} and {other} are collinear: their estimates have a correlation of {r:.3f}."
        yield (
            f"Size of the test: {100 * self.size:g} % of a step, shared by the terms that it tries (Bonferroni); a "
            f"term is removed above {100 * self.size:g} %."
        )


def stepwise(
    problem: AnyProblem,
    candidates: Sequence[str] | Mapping[str, float],
    *,
    size: float = SIGNIFICANT,
    starts: int = 4,
) -> StepwiseSelection:
    """Choose terms of a model from a list of candidates, by adding and removing them one at a time.

    Parameters
    ----------
    problem : Problem or Sum
        With a model that has all candidates.
    candidates : sequence of str, or mapping of name to value
        Parameters, by their names outside; the value of each where its term is absent, zero if it
        is not stated.
    size : float
        Of the tests, each of them the one of `nested_test`: the ratio of the costs.
    starts : int
        Sobol points from which every structure is fitted, beside the estimate of the one before.

    Raises
    ------
    ValueError
        For candidates that are no parameters of the problem, a size out of range, or a structure
        without any candidate that has no fit.
    """
    absent = dict(candidates) if isinstance(candidates, Mapping) else dict.fromkeys(candidates, 0.0)
    require_known(absent, problem.parameters, "parameter", repr(problem.name))
    if not 0 < size < 1:
        raise ValueError(f"size is {size}: give a probability, e.g. {SIGNIFICANT}.")
    search = _Search(problem, absent, starts)
    current: Terms = frozenset()
    without = search.fit(current, None)
    if without is None:
        raise ValueError(
            f"the problem {problem.name!r} has no fit without any of {', '.join(absent)}."
        )

    trials: list[Trial] = []
    seen, step, fit = {current}, 0, without
    while True:
        step += 1
        tried = search.additions(current, fit, step, size)
        best = min(
            (t for t in tried if t.p_value < t.limit),
            key=lambda t: (t.p_value, t.cost),
            default=None,
        )
        trials += [_done(t, t is best) for t in tried]
        if best is None or current | {best.term} in seen:
            break
        current = current | {best.term}
        seen.add(current)
        while len(current) > 1:
            fit = search.required(current)
            tried = search.removals(current, fit, step, size)
            worst = max(
                (t for t in tried if t.p_value > t.limit), key=lambda t: t.p_value, default=None
            )
            if worst is not None and current - {worst.term} in seen:
                worst = None
            trials += [_done(t, t is worst) for t in tried]
            if worst is None:
                break
            current = current - {worst.term}
            seen.add(current)
        fit = search.required(current)
    return StepwiseSelection(
        candidates=tuple(absent),
        terms=tuple(name for name in absent if name in current),
        fit=fit,
        without=without,
        trials=tuple(trials),
        alike=search.alike(current, fit),
        size=size,
    )


def _done(trial: Trial, done: bool) -> Trial:
    return Trial(**{**vars(trial), "done": done})


class _Search:
    """Fits of a problem with some of its terms, each made once."""

    def __init__(self, problem: AnyProblem, absent: Mapping[str, float], starts: int) -> None:
        self._problem, self._absent, self._starts = problem, absent, starts
        self._fits: dict[Terms, Fit | None] = {}

    def fit(self, terms: Terms, near: Fit | None) -> Fit | None:
        """Return the fit with these terms, from that of a structure nearby and a few points; None where it failed."""
        if terms not in self._fits:
            stated = with_terms(self._problem, terms, self._absent)
            free = {name for name, p in stated.parameters.items() if not p.fixed}
            start = (
                {}
                if near is None
                else {name: v for name, v in near.estimate.items() if name in free}
            )
            found = fit_problem(stated, [start, Sobol(self._starts, 0)], progress=False)
            self._fits[terms] = found if found.converged else None
        return self._fits[terms]

    def required(self, terms: Terms) -> Fit:
        found = self._fits[terms]
        assert found is not None
        return found

    def additions(self, terms: Terms, fit: Fit, step: int, size: float) -> list[Trial]:
        left = [name for name in self._absent if name not in terms]
        return [
            self._trial(
                step,
                "add",
                name,
                fit,
                self.fit(terms | {name}, fit),
                size / len(left),
                swapped=False,
            )
            for name in left
        ]

    def removals(self, terms: Terms, fit: Fit, step: int, size: float) -> list[Trial]:
        return [
            self._trial(
                step, "remove", name, self.fit(terms - {name}, fit), fit, size, swapped=True
            )
            for name in self._absent
            if name in terms
        ]

    def _trial(
        self,
        step: int,
        change: str,
        term: str,
        small: Fit | None,
        large: Fit | None,
        limit: float,
        *,
        swapped: bool,
    ) -> Trial:
        changed = small if swapped else large
        if small is None or large is None:
            return Trial(step, change, term, math.nan, math.nan, limit, why_not="no fit converged")
        try:
            p, why = nested_test(small, with_independent_errors(large)).p_value, ""
        except ValueError:
            line = next(q for q in large.quantities if q.name == term)
            is_known = math.isfinite(line.standard_error)
            p, why = (
                math.nan,
                "at its bound" if line.at_bound else "no test" if is_known else "not determined",
            )
        return Trial(
            step, change, term, changed.cost if changed else math.nan, p, limit, why_not=why
        )

    def alike(self, terms: Terms, fit: Fit) -> dict[str, dict[str, float]]:
        """Return which terms could stand in the place of each chosen one, and how much larger AIC is with them."""
        found: dict[str, dict[str, float]] = {}
        scale = cost_scale(with_independent_errors(fit))
        for term in self._absent:
            for other in self._absent:
                if term not in terms or other in terms:
                    continue
                swapped = self.fit(terms - {term} | {other}, fit)
                above = math.inf if swapped is None else 2 * (swapped.cost - fit.cost) / scale
                if above < EQUAL_AIC:
                    found.setdefault(term, {})[other] = above
        return found


def with_terms(problem: AnyProblem, terms: Terms, absent: Mapping[str, float]) -> AnyProblem:
    """Return the problem with these candidates free and the others fixed at the values where they are absent."""
    return problem.with_parts([_part(part, terms, absent) for part in problem.parts])


def _part(part: Problem, terms: Terms, absent: Mapping[str, float]) -> Problem:
    inside: dict[str, str] = {part.outside(name): name for name in part.declared}
    chosen = {inside[name] for name in terms if name in inside}
    left_out = {
        inside[name]: value
        for name, value in absent.items()
        if name not in terms and name in inside
    }
    fixed: dict[str, Any] = {
        **{n: v for n, v in part.fixed_values.items() if n not in chosen},
        **left_out,
    }
    declared_fixed = [name for name in chosen if part.model.parameters[name].fixed]
    free = [name for name in part.free if name not in left_out and name not in declared_fixed]
    return part.with_(fixed=fixed, free=[*free, *declared_fixed])


def _more(above: float) -> str:
    shown = number(round(abs(above), 2), 3)
    return "the same AIC" if shown == "0" else f"AIC {shown} {'more' if above > 0 else 'less'}"
