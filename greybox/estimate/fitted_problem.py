"""The problem of a fit, from the values of the fit, and compiled again."""

from typing import Any

from greybox.compiled.compiled_problem import AnyProblem, CompiledProblem, compile_problem
from greybox.compiled.transcription.method import Transcription
from greybox.estimate.fitted_part import FittedPart, FittedRecord, FittedResponse
from greybox.estimate.harmonic_numbers import with_enough_harmonics
from greybox.estimate.result import Fit
from greybox.formulation.included_criteria import CRITERIA, TIME_CRITERIA
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.formulation.time_criteria import TimeCriterion
from greybox.modeling.model_reference import resolve


def compiled_again(
    fit: Fit, problem: AnyProblem | None = None, method: Transcription | None = None
) -> CompiledProblem:
    """Compile the problem of a fit: the given `problem`, or the one that follows from the fit.

    Raises
    ------
    ValueError, LookupError
        As in `problem_of`, and for a problem with other free parameters or data than the fit.
    """
    problem = with_enough_harmonics(problem_of(fit) if problem is None else problem)
    nlp = compile_problem(problem, method)
    checksums = [part.data.checksum for part in nlp.problem.parts]
    if nlp.free != fit.free or checksums != [part.data.checksum for part in fit.parts]:
        raise ValueError(
            f"problem {problem.name!r} has other unknowns or other data than the fit: give the one "
            "fitted."
        )

    return nlp


def problem_of(fit: Fit) -> AnyProblem:
    """Return the problem of a fit, from the values of the fit.

    Raises
    ------
    ValueError
        If it has a prior, ties, constraints, values of an earlier fit, or a criterion of your own
        or with functions.
    LookupError
        If a loaded fit does not know its model.
    """
    held = {q.name: q for q in fit.quantities if q.kind == "fixed"}
    bounds = {q.name: q.bounds for q in fit.quantities if q.kind == "free"}
    boxes = {q.name: q.box for q in fit.quantities if q.kind == "free" and q.box != q.bounds}
    # Their covariance is not stored with the fit, and would be missing in the new one.
    uncertain = [q.name for q in held.values() if q.standard_error != 0]
    problems = []

    for k, part in enumerate(fit.parts):
        if part.is_prior:
            raise ValueError(f"the fit {fit.name!r} has a-priori knowledge: give its problem=...")
        if part.tied or part.constraints or uncertain:
            what = (
                "ties"
                if part.tied
                else "constraints"
                if part.constraints
                else f"{uncertain[0]} from an earlier fit"
            )
            raise ValueError(
                f"the fit {fit.name!r} has {what}, of which only the text is known: give its "
                "problem=..."
            )
        model = fit.models[k] if fit.models else resolve(part.model, fit.given)
        criterion: Any = _criterion(fit, part)
        declared = dict(model.parameters)
        at: dict[str, Any] = {}
        if isinstance(criterion, TimeCriterion):
            assert isinstance(part, FittedRecord)
            declared |= criterion.parameters(model, part.data)
        else:
            assert isinstance(part, FittedResponse)
            at = {"at": part.at, "amplitude": part.sine}
        outside = {name: part.rename.get(name, name) for name in declared}
        problems.append(
            Problem(
                model,
                part.data,
                criterion,
                fixed={
                    name: held[outside[name]].value for name in declared if outside[name] in held
                },
                free=[
                    name for name, p in declared.items() if p.fixed and outside[name] not in held
                ],
                delay=part.delay,
                rename=part.rename,
                weight=part.weight,
                name=part.name,
                bounds={
                    name: bounds[outside[name]] for name in declared if outside[name] in bounds
                },
                starts={name: boxes[outside[name]] for name in declared if outside[name] in boxes},
                **at,
            )
        )

    return problems[0] if len(problems) == 1 else Sum(tuple(problems), fit.name)


def _criterion(fit: Fit, part: FittedPart) -> Any:
    for kind in dict.fromkeys(type(criterion) for criterion in (*CRITERIA, *TIME_CRITERIA)):
        if kind().class_path != part.criterion_class:
            continue
        criterion = kind(**part.settings)
        functions = [
            name
            for name, value in part.settings.get("initial", {}).items()
            if isinstance(value, str)
        ]
        if functions:
            raise ValueError(
                f"the fit {fit.name!r} has a function for the initial {functions[0]}, of which "
                "only the text is known: give its problem=..."
            )
        return criterion
    raise ValueError(
        f"the fit {fit.name!r} has the criterion {part.criterion}, not one of greybox: give its "
        "problem=..."
    )
