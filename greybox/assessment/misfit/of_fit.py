"""The test of misfit of a fit that is at hand, with terms of the user."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from greybox.assessment.fitted_problem import compiled_again
from greybox.assessment.misfit.answer import Misfit
from greybox.assessment.misfit.assessment import assessed_misfit
from greybox.assessment.misfit.causes.included import CAUSES, RecordCause
from greybox.assessment.result import Fit, require_fit
from greybox.data.files.argument_checks import require_kind
from greybox.data.files.public import public
from greybox.engine.compiled.compiled_problem import AnyProblem
from greybox.engine.solve.search_method import solver_for
from greybox.modeling.added_terms import Formula


@public
def misfit(
    fit: Fit,
    problem: AnyProblem | None = None,
    candidates: Mapping[str, Formula] = MappingProxyType({}),
    causes: Sequence[RecordCause] = CAUSES,
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
    causes : sequence of functions, optional
        What is tried for records, ``gb.CAUSES`` by default: functions that yield the terms
        (`gb.RecordTerm`) which the model of a record may lack. Your own joins them by
        ``causes=[*gb.CAUSES, mine]``.

    Returns
    -------
    Misfit or None
        None where that cannot be decided, as for rows without a time. `Fit.misfit` is the same
        without candidates.

    Raises
    ------
    TypeError
        If causes are no functions.
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
    if isinstance(causes, str) or not all(callable(cause) for cause in causes):
        raise TypeError(
            f"causes is {causes!r:.80}: give functions of a record that yield terms, "
            "[*gb.CAUSES, mine]."
        )
    nlp = compiled_again(fit, problem)
    x = fit.minima[0].estimate
    trajectories = solver_for(nlp).profile(x).trajectories
    return assessed_misfit(nlp, x, trajectories, fit.at_bound, candidates, causes)
