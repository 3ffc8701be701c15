"""What the estimate owes to an assumption on how the inputs run between their samples, which the data cannot tell.

A control that is held acts half a sample later than one that is interpolated. Delays and lags, and
with them other parameters, take that up without a trace in the residuals. Where the record does not
know it, or the criterion says otherwise than the record, the answer says by how much the other
assumption would move it, by one more run from the estimate. (A single Gauss-Newton step is not
enough: where parameters hardly differ in their effects, it was measured to be wrong by half a
standard error.)
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Part
from greybox.compiled.record_part import RecordPart
from greybox.data.intersample import Intersample
from greybox.estimate.covariance import Accuracy
from greybox.files.arrays import Array
from greybox.formulation.input_assumptions import assumption_warning, effect_of, other_assumptions
from greybox.solve.gauss_newton.driver import GaussNewton

Others = Mapping[str, Intersample]


def intersample_warnings(nlp: CompiledProblem, x: Array, accuracy: Accuracy) -> Iterator[str]:
    """Say what the estimate `x` (p,) would be under the other assumption, where there is one and it matters."""
    others = {k: found for k, part in enumerate(nlp.parts) if (found := _others(part))}
    if not others:
        return
    shift = _shift(nlp, x, others)
    errors = np.sqrt(np.maximum(np.diag(accuracy.covariance)[: len(nlp.free)], 0.0))
    delays = {name for k, found in others.items() for name in _delays(nlp.parts[k], found)}
    parameters = {name: nlp.problem.parameters[name] for name in nlp.free}
    effect = effect_of(parameters, shift, errors, delays)
    if effect:
        part = nlp.parts[min(others)]
        assert isinstance(part, RecordPart)
        criterion = part.model.criterion
        all_others = {name: other for found in others.values() for name, other in found.items()}
        between = {name: now for k in others for name, now in _between(nlp.parts[k]).items()}
        yield assumption_warning(
            type(criterion).__name__, criterion.inputs, between, all_others, effect
        )


def _between(part: Part) -> dict[str, Intersample]:
    if not isinstance(part, RecordPart):
        return {}
    return dict(zip(part.system.inputs, part.model.between, strict=True))


def _others(part: Part) -> Others:
    """Return how the inputs of a part might run instead; a model without states and delays does not notice."""
    if not isinstance(part, RecordPart) or part.is_static:
        return {}
    return other_assumptions(part.model.criterion.inputs, _between(part), part.model.record)


def _shift(nlp: CompiledProblem, x: Array, others: Mapping[int, Others]) -> Array:
    """Return by how much the unknowns (p,) move from `x` if the inputs run as they might instead; NaN if not known."""
    parts = tuple(
        _with_inputs(part, others[k]) if k in others else part for k, part in enumerate(nlp.parts)
    )
    end = GaussNewton(replace(nlp, parts=parts)).run(x)
    return end.estimate - x if end.converged else np.full(len(x), np.nan)


def _with_inputs(part: Part, others: Others) -> Part:
    assert isinstance(part, RecordPart)
    return part.with_inputs(tuple({**_between(part), **others}.values()))


def _delays(part: Part, others: Others) -> Iterator[str]:
    """Name the parameters in the delays of these inputs."""
    assert isinstance(part, RecordPart)
    system = part.system
    p = ca.SX.sym("p", len(system.parameters))
    delay = system.delay(p)
    for i, name in enumerate(system.inputs):
        for j, parameter in enumerate(system.parameters):
            if name in others and ca.depends_on(delay[i], p[j]):
                yield part.problem.rename.get(parameter, parameter)
