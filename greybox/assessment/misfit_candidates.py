"""The test of misfit of a fit that is at hand, with terms of the user."""

from collections.abc import Mapping
from types import MappingProxyType

from greybox.assessment.fitted_problem import compiled_again
from greybox.assessment.misfit import Misfit
from greybox.assessment.misfit_assessment import assessed_misfit
from greybox.assessment.result import Fit, require_fit
from greybox.data.files.argument_checks import require_kind
from greybox.engine.compiled.compiled_problem import AnyProblem
from greybox.engine.solve.search_method import solver_for
from greybox.modeling.added_terms import Formula


def misfit(
    fit: Fit,
    problem: AnyProblem | None = None,
    candidates: Mapping[str, Formula] = MappingProxyType({}),
) -> Misfit | None:
    """Test whether the model of a fit explains its data, and what it may lack, without another fit.

    Parameters
    ----------
    fit : Fit
    problem : Problem or a sum of problems, optional
        The fitted one, where it does not follow from the fit (priors, ties, constraints).
    candidates : mapping of name to function
        Terms of your own, as functions ``lambda x, u, p: abs(x.v) * x.v`` of states, inputs and
        parameters as arrays. They are tried in the equation of every state of a `StateSpace`.

    Returns
    -------
    Misfit or None
        None where that cannot be decided, as for rows without a time. `Fit.misfit` is the same
        without candidates.

    Raises
    ------
    ValueError, LookupError
        If the problem does not follow from the fit, or is another one, or for candidates without a
        record of a `StateSpace`.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> fit = gb.fit(pitch_hover.problem(), starts=20)
    >>> gb.misfit(fit).explains
    True
    """
    require_fit(fit)
    fit.require_estimate()
    require_kind("candidates", candidates, Mapping, "{name: function of x, u and p}")
    if candidates and not fit.records:
        raise ValueError(
            f"candidates are terms in the equations of a record, and {fit.name!r} has no record: "
            "leave them out, or fit the time history."
        )
    nlp = compiled_again(fit, problem)
    x = fit.minima[0].estimate
    solver = solver_for(nlp)
    trajectories = solver.profile(x).trajectories
    return assessed_misfit(nlp, x, trajectories, fit.at_bound, candidates, solver)
