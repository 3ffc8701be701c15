"""Fits of a structure in stages: each stage may hold what the stages before it estimated.

Begin with `fit_in_stages`. A model that is too large to be fitted from anywhere has a method
``stages(recordings)``, which returns a sequence of `Stage`. The paper identifies a rotor first, and
then the attitude dynamics with the rotor's values: ``fixed={"T_rotor": fits["rotor"]}`` does the
same, and carries the covariance.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Any, Protocol, runtime_checkable

from greybox.assessment.fit import fit
from greybox.assessment.result import Fit
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import without
from greybox.data.files.printed import one_line
from greybox.data.record import Recording
from greybox.engine.compiled.compiled_problem import AnyProblem
from greybox.engine.compiled.transcription.method import Transcription
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.model import require_known
from greybox.workflows.identification.structure_fit import stated_for


@frozen
class Stage:
    """One fit of several.

    Attributes
    ----------
    name : str
    about : str
        What it estimates, from which signals, by which criterion and why.
    problem : function
        ``problem(fits)`` returns the problem, given the fits of the earlier stages by name. It
        states `fixed` and `prior` as mappings.
    starts : int or function
        A number of starts, or ``starts(fits)``, a list of points.
    method : Transcription, optional
    solver_options : mapping
        As of `fit`, such as ``{"max_iter": 100}``.
    """

    name: str
    about: str
    problem: Callable[[Mapping[str, Fit]], AnyProblem]
    starts: int | Callable[[Mapping[str, Fit]], Sequence[Mapping[str, float]]] = 1
    method: Transcription | None = None
    solver_options: Mapping[str, Any] = field(default_factory=dict)


@runtime_checkable
class Staged(Protocol):
    """A model that says how it is fitted to logs in stages."""

    def stages(self, recordings: Sequence[Recording]) -> Sequence[Stage]:
        """Return the stages, first to last."""
        ...


@frozen
class StagedIdentification:
    """A model fitted to logs in stages; printed, it shows what every stage does, and its fit.

    Attributes
    ----------
    recordings : tuple of Recording
    label : str
        The structure as a person or the command line names it.
    stages : tuple of Stage
    fits : mapping of str to Fit
        By stage. A stage that follows a failed one is not there.
    """

    recordings: tuple[Recording, ...]
    label: str
    stages: tuple[Stage, ...]
    fits: Mapping[str, Fit]

    @property
    def fit(self) -> Fit:
        """The fit of the last stage with an estimate, or of the first stage."""
        estimates = [result for result in self.fits.values() if result.converged]
        return (estimates or [*self.fits.values()])[-1]

    @property
    def failure(self) -> str:
        """Which stage has no estimate, as a sentence; empty if all have."""
        failed = [name for name, result in self.fits.items() if not result.converged]
        if not failed:
            return ""
        return (
            f"no start of the stage {failed[0]!r} converged: its warnings say why. The estimates "
            "are those of the stages before it."
        )

    def __repr__(self) -> str:
        return one_line(self, self.label, ", ".join(self.fits))

    def __str__(self) -> str:
        parts = []
        for number, stage in enumerate(self.stages, 1):
            parts.append(f"Stage {number}, {stage.name}: {stage.about}")
            parts.append(str(self.fits.get(stage.name, "not fitted.")))
        return "\n\n".join(parts)


def fit_in_stages(
    model: Any,
    recordings: Sequence[Recording],
    stated: Mapping[str, Any],
    *,
    label: str = "",
    seed: int = 0,
) -> StagedIdentification:
    """Fit a model to logs in the stages that it states.

    Parameters
    ----------
    model : Staged
    recordings : sequence of Recording
    stated : mapping
        `fixed`, `free`, `bounds` and `start`, as in `Problem`. They replace those of the stages.

    Raises
    ------
    KeyError, ValueError
        If a log lacks a signal, or no stage has a parameter of this name.
    """
    stages = tuple(model.stages(recordings))
    names = [name for values in stated.values() for name in values]
    require_known(names, model.parameters, "parameter", model.label)
    fits: dict[str, Fit] = {}
    for stage in stages:
        problem = _restated(stage.problem(fits), stated)
        starts: Any = stage.starts
        drawn = isinstance(starts, int)
        fits[stage.name] = fit(
            problem,
            starts if drawn else starts(fits),
            seed if drawn else None,
            method=stage.method,
            solver_options=stage.solver_options,
            profiles=False,
            progress=False,
        )
        if not fits[stage.name].converged:
            break
    return StagedIdentification(tuple(recordings), label or model.label, stages, fits)


def _restated(problem: AnyProblem, stated: Mapping[str, Any]) -> AnyProblem:
    """Return the problem with the options that its parts have parameters for."""
    parts: list[Problem] = []
    for part in problem.as_added:
        fixed: Any = part.fixed
        prior: Any = part.prior
        options = stated_for(part.model, stated)
        wanted = options.pop("free", ())
        fixed = {**without(fixed, wanted), **options.pop("fixed", {})}
        merged = {name: {**getattr(part, name), **values} for name, values in options.items()}
        free = [name for name in (*part.free, *wanted) if name not in fixed]
        unknown = {"free": free, "prior": without(prior, fixed)}
        parts.append(part.with_(fixed=fixed, **unknown, **merged))
    return problem.with_parts(parts)
