"""Terms of a model chosen from a list of candidates: added and removed one at a time, by a test.

A term is a parameter. It is absent if the parameter is zero, or has another stated value. Each step
adds the term with the smallest p-value, if that is below 5 % divided by the number
of terms tried. It then removes terms that are no longer needed. Finally every rejected term takes
the place of each chosen one, to find terms that the data cannot distinguish.

Source: Klein and Morelli (2006), Aircraft System Identification, section 5.4, with the
correction of Bonferroni.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from greybox.assessment.fit import fit as fit_problem
from greybox.assessment.misfit.answer import Misfit
from greybox.assessment.result import Fit
from greybox.assessment.validation.comparison import EQUAL_AIC, SIGNIFICANT
from greybox.assessment.validation.nested_models import (
    NestedTest,
    cost_scale,
    f_tail,
    nested_test_at,
)
from greybox.data.files.argument_checks import as_names
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values, selected, without
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.progress import bar
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import counted, listed
from greybox.engine.compiled.compiled_problem import AnyProblem, require_problem
from greybox.modeling.added_terms import AddedTerms
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.starts import Sobol
from greybox.modeling.model import require_known

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
        Cost with the change; NaN where no fit converged.
    p_value : float
        p-value of the term; NaN where it could not be tested.
    limit : float
        The p-value below which the term is added, or above which it is removed.
    done : bool
    why_not : str
        The reason why there is no test.
    """

    step: int
    change: str
    term: str
    cost: float
    p_value: float
    limit: float
    done: bool = False
    why_not: str = ""

    @property
    def row(self) -> list[str]:
        """The row of the printed table: step, change, term, cost, p-value, limit, outcome."""
        outcome = ""
        if self.done:
            outcome = "added" if self.change == "add" else "removed"
        return [
            str(self.step),
            self.change,
            self.term,
            number(self.cost, 6),
            self.why_not or number(self.p_value, 2),
            f"{self.limit:.2g}",
            outcome,
        ]


@public
@frozen
class StepwiseSelection(Printed):
    """The terms that the data support. Printing it shows every step.

    Attributes
    ----------
    candidates, terms : tuple of str
        The terms that could be chosen, and the chosen ones.
    fit, without : Fit
        The fits with the chosen terms, and without any candidate.
    trials : tuple of Trial
    alike : mapping of str to mapping of str to float
        For each chosen term those that could replace it, with the increase in AIC: less than 2, so
        the data do not tell them apart.
    doubtful : mapping of str to float
        p-values of chosen terms that are needed only if the errors are independent along frequency.
    """

    candidates: tuple[str, ...]
    terms: tuple[str, ...]
    fit: Fit
    without: Fit
    trials: tuple[Trial, ...]
    alike: Mapping[str, Values]
    doubtful: Values

    @property
    def verdict(self) -> str:
        """The chosen terms, in one sentence."""
        tried = counted(len(self.candidates), "candidate")
        if not self.terms:
            return f"None of {tried} is supported: no term lowers the cost by more than chance."
        text = (
            f"{listed(self.terms)} of {tried} {'is' if len(self.terms) == 1 else 'are'} supported: "
            f"cost {number(self.fit.cost, 6)} instead of {number(self.without.cost, 6)} without."
        )
        if self.doubtful:
            text += (
                " If errors of neighboring points are correlated like the residuals, "
                f"{listed(list(self.doubtful))} may be there by chance."
            )
        return text

    def __str__(self) -> str:
        rows = [trial.row for trial in self.trials]
        table = text_table(["step", "", "term", "cost", "p", "limit", ""], rows, left=(1, 2, 6))
        text = f"{self.fit.name}: stepwise selection at {100 * SIGNIFICANT:g} % (Bonferroni)"
        text += f"\n\n{self.verdict}\n\n{table}\n"
        for term, rivals in self.alike.items():
            texts = listed([f"{rival} (AIC {above:+.2f})" for rival, above in rivals.items()])
            text += f"\nThese data cannot tell {term} from {texts}."
        return text


@public
def stepwise(
    problem: AnyProblem,
    candidates: Sequence[str] | Values | Misfit,
    *,
    starts: int = 4,
) -> StepwiseSelection:
    """Choose terms of a model from a list of candidates, by adding and removing them one at a time.

    If several terms lower the cost equally, the first in the list is added. Where the larger model
    of a test does not explain the data, since more terms are missing, errors of responses count as
    of equal size.

    Parameters
    ----------
    problem : Problem or Sum
        With a model that has all candidates.
    candidates : sequence of str, mapping of name to value, or Misfit
        Parameters, by their names in the problem, and the value of each where its term is absent:
        zero by default. For a misfit (`Fit.misfit`, or `gb.misfit` with terms of your own), its
        significant terms in equations of states are added to the model.
    starts : int
        Sobol points from which every structure is fitted, besides the previous estimate.

    Raises
    ------
    TypeError, ValueError
        For no problem, for no candidates or some that are not its parameters, or if the structure
        without any candidate has no fit.

    Examples
    --------
    >>> class Cart(gb.StateSpace):
    ...     'A cart that rolls and is braked by the air, perhaps.'
    ...
    ...     states = outputs = ("v",)
    ...     inputs = ("F",)
    ...     b = gb.Parameter(1.0, bounds=(0, 10), unit="1/kg", about="acceleration per force")
    ...     c = gb.Parameter(0.1, bounds=(-5, 5), unit="1/s", about="rolling")
    ...     d = gb.Parameter(0.1, bounds=(-5, 5), unit="1/m", about="air")
    ...
    ...     def derivative(self, x, u, p):
    ...         return (p.b * u.F - p.c * x.v - p.d * abs(x.v) * x.v,)
    ...
    ...     def output(self, x, u, p):
    ...         return (x.v,)
    >>> random = np.random.default_rng(0)
    >>> force = gb.Record(np.arange(200) / 20, {"F": np.repeat(random.normal(size=20), 10)})
    >>> v = gb.simulate(Cart(), {"c": 0.5, "d": 0}, force)["v"] + 0.01 * random.normal(size=200)
    >>> record = gb.Record(force.time, {"F": force["F"], "v": v})
    >>> gb.stepwise(gb.Problem(Cart(), record), ["c", "d"], starts=1).terms
    ('c',)
    """
    require_problem(problem)
    if isinstance(candidates, Misfit):
        problem, candidates = _with_causes(problem, candidates)
    is_mapping = isinstance(candidates, Mapping)
    absent = dict(candidates) if is_mapping else dict.fromkeys(as_names(candidates), 0.0)
    if not absent:
        raise ValueError("there are no candidates: name at least one parameter.")
    require_known(absent, problem.parameters, "parameter", repr(problem.name))
    fits = _Fits(problem, absent, starts)
    current: Terms = frozenset()
    without = fits.fit_of(current, None)
    if not without.converged:
        raise ValueError(
            f"the problem {problem.name!r} has no fit without any of {', '.join(absent)}: give "
            f"starts={5 * starts}, or leave those out of the candidates that the model needs."
        )

    trials: list[Trial] = []
    visited = {current}  # no structure is chosen twice: the search must end
    step = 0
    while len(current) < len(absent):
        step += 1
        tried, added = _trials_of_additions(fits, step, current)
        trials += tried
        if added is None or current | {added} in visited:
            break
        current = current | {added}
        visited.add(current)

        while len(current) > 1:
            tried, removed = _trials_of_removals(fits, step, current, visited)
            trials += tried
            if removed is None:
                break
            current = current - {removed}
            visited.add(current)

    return StepwiseSelection(
        candidates=tuple(absent),
        terms=tuple(selected(absent, current)),
        fit=fits.new_fit(current, fits.cache[current], profiles=True),
        without=without,
        trials=tuple(trials),
        alike=fits.alike(current),
        doubtful=fits.doubtful(current),
    )


def _trials_of_additions(
    fits: "_Fits", step: int, current: Terms
) -> tuple[list[Trial], str | None]:
    """Try to add every absent term; also return the term to add, None if none is significant."""
    # Bonferroni: the smallest of many p-values is small by chance.
    limit = SIGNIFICANT / (len(fits.absent) - len(current))
    trials = []
    for name in bar(fits.absent, desc="trying terms"):
        if name not in current:
            trials.append(fits.trial(step, name, current, limit))
    significant = [trial for trial in trials if trial.p_value < trial.limit]
    if not significant:
        return trials, None

    lowest = min(significant, key=lambda trial: (trial.p_value, trial.cost))
    # Costs of equivalent terms differ by rounding: 1e-6 is far above it, and far below what any
    # test sees. Of equal costs, the first in the list counts.
    equal = [t for t in significant if math.isclose(t.cost, lowest.cost, rel_tol=1e-6)]
    best = equal[0]
    return [replace(trial, done=trial is best) for trial in trials], best.term


def _trials_of_removals(
    fits: "_Fits", step: int, current: Terms, visited: set[Terms]
) -> tuple[list[Trial], str | None]:
    """Try to remove every chosen term; also return the term to remove, None if all are needed."""
    chosen = selected(fits.absent, current)
    trials = [fits.trial(step, name, current, SIGNIFICANT) for name in chosen]
    unneeded = []
    for trial in trials:
        if trial.p_value > trial.limit and current - {trial.term} not in visited:
            unneeded.append(trial)
    if not unneeded:
        return trials, None

    least = max(unneeded, key=lambda trial: trial.p_value)
    return [replace(trial, done=trial is least) for trial in trials], least.term


def _with_causes(problem: AnyProblem, misfit: Misfit) -> tuple[AnyProblem, list[str]]:
    """Return the problem with the terms of a misfit, and the names of their factors."""
    terms = {}
    states = set()
    for cause in misfit.causes:
        if cause.added and cause.p_value < SIGNIFICANT:
            state, formula = cause.added
            states.add(state)
            # The name of a parameter has letters, digits and underscores only.
            name = re.sub(r"\W+", "_", cause.text.replace("the equation of ", ""))
            terms[name] = (state, formula, cause.value)
    if not terms:
        raise ValueError(
            "no significant cause of this misfit can be added to the equation of a state: change "
            "the model as the misfit says; for a fit that was loaded, give gb.misfit(fit)."
        )
    parts = []
    for part in problem.parts:
        if states <= {*part.model.state_names}:
            part = part.with_(model=AddedTerms(part.model, terms))  # type: ignore[arg-type]  # noqa: PLW2901
        parts.append(part)
    return problem.with_parts(parts), [*terms]


class _Fits:
    """Fits of a problem with some of its terms. Each structure is fitted once.

    Attributes
    ----------
    problem : Problem or Sum
        With all candidates.
    absent : mapping of str to float
        Value of each candidate where its term is absent.
    starts : int
        Sobol points from which every structure is fitted.
    cache : mapping of set of str to Fit
        The fits so far, by their terms.
    """

    def __init__(self, problem: AnyProblem, absent: Values, starts: int) -> None:
        self.problem = problem
        self.absent = absent
        self.starts = starts
        self.cache: dict[Terms, Fit] = {}

    def fit_of(self, terms: Terms, near: Fit | None) -> Fit:
        """Return the fit with these terms; a new one also starts from a fit nearby."""
        if terms not in self.cache:
            # No test needs profiles, which take a third of the time.
            self.cache[terms] = self.new_fit(terms, near, profiles=False)
        return self.cache[terms]

    def new_fit(self, terms: Terms, near: Fit | None, *, profiles: bool) -> Fit:
        """Fit the problem with these terms from Sobol points and the estimate of a fit nearby."""
        problem = with_terms(self.problem, terms, self.absent)
        free = {name for name, p in problem.parameters.items() if not p.fixed}
        start = {} if near is None else selected(near.estimate, free)
        return fit_problem(problem, [start, Sobol(self.starts)], profiles=profiles, progress=False)

    def trial(self, step: int, term: str, terms: Terms, limit: float) -> Trial:
        """Test a term that is added to these terms, or removed from them."""
        fit = self.cache[terms]
        changed = self.fit_of(terms ^ {term}, fit)
        if term in terms:
            change, small, large = "remove", changed, fit
        else:
            change, small, large = "add", fit, changed

        test, why_not = None, "no fit converged"
        if changed.converged:
            test, why_not = self._test(term, small, large)
        p_value = math.nan if test is None else test.p_value
        return Trial(step, change, term, changed.cost, p_value, limit, why_not=why_not)

    def _test(self, term: str, small: Fit, large: Fit) -> tuple[NestedTest | None, str]:
        """Return the test of a term, or None and the reason why there is no test."""
        # A missing term leaves residuals that look like errors correlated along frequency. If such
        # errors were allowed, no test would find the term: here errors count as independent.
        removed = {term: self.absent[term]}
        try:
            test = nested_test_at(removed, small, large, ("without", "with"), independent=True)
        except ValueError:
            quantity = large.by_name[term]
            if quantity.at_bound:
                return None, "at its bound"
            is_determined = math.isfinite(quantity.standard_error)
            return None, "no test" if is_determined else "not determined"
        return test, ""

    def doubtful(self, terms: Terms) -> Values:
        """Return the p-values of terms that only a test for independent errors finds."""
        fit = self.cache[terms]
        p_values = {}
        for term in selected(self.absent, terms):
            small = self.fit_of(terms - {term}, fit)
            test, _ = self._test(term, small, fit)
            if test is None:
                continue
            # The term may explain the correlated errors, so the fit without it states their effect.
            p_value = f_tail(test.statistic / small.inflation, 1, small.dof)
            if p_value > SIGNIFICANT:
                p_values[term] = p_value
        return p_values

    def alike(self, terms: Terms) -> Mapping[str, Values]:
        """Return the terms that could replace each chosen one, and the increase in AIC."""
        rivals: dict[str, dict[str, float]] = {}
        fit = self.cache[terms]
        scale = cost_scale(fit)
        for term in selected(self.absent, terms):
            for rival in without(self.absent, terms):
                swapped = self.fit_of(terms - {term} | {rival}, fit)
                above = 2 * (swapped.cost - fit.cost) / scale
                if swapped.converged and above < EQUAL_AIC:
                    rivals.setdefault(term, {})[rival] = above
        return rivals


def with_terms(problem: AnyProblem, terms: Terms, absent: Values) -> AnyProblem:
    """Return the problem with these candidates free, and the others fixed where they are absent."""
    return problem.with_parts([_part(part, terms, absent) for part in problem.parts])


def _part(part: Problem, terms: Terms, absent: Values) -> Problem:
    """Return a part with its candidates free or fixed; its own names of them may be other ones."""
    chosen = set()
    absent_here = {}
    for name in part.declared:
        candidate = part.outside(name)
        if candidate not in absent:
            continue
        if candidate in terms:
            chosen.add(name)
        else:
            absent_here[name] = absent[candidate]

    fixed = without({**part.fixed_values, **absent_here}, chosen)
    free = [name for name in part.free if part.outside(name) not in absent]
    return part.with_(fixed=fixed, free=[*free, *sorted(chosen)])
