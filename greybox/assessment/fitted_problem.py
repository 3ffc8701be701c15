"""The problem of a fit, from the values of the fit, and compiled again."""

from collections.abc import Mapping
from typing import Any

from greybox.assessment.fitted_part import FittedPart
from greybox.assessment.result import Fit
from greybox.engine.compiled.compiled_problem import AnyProblem, CompiledProblem, compile_problem
from greybox.engine.compiled.transcription.method import Transcription
from greybox.engine.solve.robust_fit import with_pseudo_values
from greybox.modeling.formulation.error_covariance import is_included
from greybox.modeling.formulation.included_criteria import (
    CRITERIA,
    SPECTRUM_CRITERIA,
    TIME_CRITERIA,
)
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.sum import Sum
from greybox.statistics.included_errors import ERRORS

# Only classes of greybox are looked up: a file must not name code that is then run.
ALL = (*CRITERIA, *TIME_CRITERIA, *SPECTRUM_CRITERIA)
KINDS: dict[str, Any] = {criterion.class_path: type(criterion) for criterion in ALL}


def compiled_again(
    fit: Fit, problem: AnyProblem | None = None, method: Transcription | None = None
) -> CompiledProblem:
    """Compile the problem of a fit: the given `problem`, or the one that follows from the fit.

    Raises
    ------
    ValueError, LookupError
        As in `problem_of`, and for a problem with other free parameters or data than the fit.
    """
    problem = problem_of(fit) if problem is None else problem
    nlp = compile_problem(problem, method)
    # The values of the fit are used as a point of this problem, so the unknowns must be the same.
    checksums = [part.data.checksum for part in nlp.problem.parts]
    if nlp.free != fit.free or checksums != [part.data.checksum for part in fit.parts]:
        raise ValueError(
            f"problem {problem.name!r} has other unknowns or other data than the fit: give the one "
            "fitted."
        )

    return with_pseudo_values(nlp, fit.minima[0].estimate)


def has_included_criterion(part: FittedPart) -> bool:
    """Return whether the criterion of a part, and the errors that it assumes, are of greybox."""
    return part.criterion_class in KINDS and has_included_errors(part)


def has_included_errors(part: FittedPart) -> bool:
    """Return whether the distribution of the errors and their covariance are of greybox."""
    # Criteria of responses state no noise.
    return part.errors in ERRORS and is_included(part.settings.get("noise", {}))


def problem_of(fit: Fit) -> AnyProblem:
    """Return the problem of a fit, from the values of the fit.

    Raises
    ------
    ValueError
        If it has a prior, ties, constraints, values of an earlier fit, errors of your own, or a
        criterion of your own or with functions.
    LookupError
        If a loaded fit does not know its model.
    """
    free = [q for q in fit.quantities if q.kind == "free"]
    held = {q.name: q.value for q in fit.quantities if q.kind == "fixed"}
    stated = {
        "fixed": held,
        "bounds": {q.name: q.bounds for q in free},
        "starts": {q.name: q.box for q in free if q.box != q.bounds},
    }
    # The fit has no covariance of values from an earlier fit, so the new one would ignore them.
    uncertain = [name for name in held if fit.by_name[name].standard_error != 0]
    problems = []

    for k, part in enumerate(fit.parts):
        initial: Mapping[str, Any] = part.settings.get("initial", {})
        obstacles = {
            "priors": part.is_prior,
            "ties": part.tied,
            "constraints": part.constraints,
            f"{', '.join(uncertain)} from an earlier fit": uncertain,
            f"the criterion {part.criterion}": part.criterion_class not in KINDS,
            "errors of your own": not has_included_errors(part),
            "a function for an initial state": any(isinstance(v, str) for v in initial.values()),
        }
        for what, present in obstacles.items():
            if present:
                raise ValueError(
                    f"the fit {fit.name!r} has {what}, which it does not store: give its "
                    "problem=..."
                )
        model = fit.model_of(k)
        criterion = KINDS[part.criterion_class](**part.settings)
        # A record has no operating point.
        problem = Problem(
            model,
            part.data,
            criterion,
            delay=part.delay,
            rename=part.rename,
            weight=part.weight,
            name=part.name,
            at=part.at,
        )
        declared = problem.declared
        outside = {name: part.outside(name) for name in declared}
        problems.append(
            problem.with_(
                # What the model declares fixed and the fit estimated was freed by its problem.
                free=[
                    name for name, p in declared.items() if p.fixed and outside[name] not in held
                ],
                **{
                    what: {name: values[o] for name, o in outside.items() if o in values}
                    for what, values in stated.items()
                },
            )
        )

    return problems[0] if len(problems) == 1 else Sum(tuple(problems), fit.name)
