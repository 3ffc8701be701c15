"""Substeps of a sample and samples of a segment.

The rule for substeps is that of `greybox.modeling.step_size`. Here it is applied to the model along
the measured data, at the declared parameters and at others drawn from the start boxes, where the
search will go. A run that goes where they are unstable continues with twice as many
(`greybox.engine.solve.gauss_newton.driver`). Whether they are accurate enough is judged at the
minimum (`greybox.engine.solve.discretization_error`).
"""

import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.compiled.initial_states import at_samples
from greybox.engine.compiled.record_model import RecordModel
from greybox.engine.compiled.sampled_data import SampledData
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.step_size import stable_substeps

# Number of parameter vectors, the declared one first. With 17, the quartile is one of them, and a
# few odd draws do not move it.
DRAWS = 17
QUARTILE = 12  # np.quantile imports masked arrays, which takes longer than sorting


def substeps_and_segment(
    model: RecordModel, drawn: Array, data: SampledData, step: float
) -> tuple[int, int]:
    """Return the substeps per sample and samples per segment: of the method, or as needed.

    The poles along the data need the upper quartile of the substeps over the draws, and no less
    than the declared parameters need. More than `MOST_SUBSTEPS` say that the model is stiff there.

    Parameters
    ----------
    drawn : (draws, declared) array
        See `drawn_parameters`.
    data : SampledData
        In segments of one sample.
    step : float
        The longest from one sample to the next, s.
    """
    system, initial_states, integrator = model.system, model.initial_states, model.method.scheme

    # At twenty samples, the shortest time constant of an igniting reactor is missed, and two of
    # three runs stall. The poles of 60 states take as long as those of 15 at 64 times as many
    # samples.
    samples = int(np.clip(100 * (15 / max(len(system.states), 1)) ** 3, 3, 100))
    outputs, inputs = at_samples(data, max(data.segments // samples, 1), spread=True)
    counts: list[int] = []
    growth_rates: list[float] = []
    # Gains of process noise are not drawn, and no initial state depends on them.
    with_gains = np.pad(drawn, ((0, 0), (0, len(model.parameters) - drawn.shape[1])))
    for declared, known in zip(drawn, model.initial(with_gains.T).full().T, strict=True):
        p = declared[: len(system.parameters)]
        poles = initial_states.poles(initial_states.at(outputs, inputs, p, known), inputs, p)
        counts.append(stable_substeps(poles, step, reach=integrator.reach, wave=integrator.wave))
        fastest = poles.real.max(axis=1, initial=-np.inf)
        growth_rates.append(fastest.sum() / max(fastest.size, 1))

    # An unstable mode may grow by exp(2), sevenfold, over a segment. On the unstable tilt plant
    # segments of 5 to 20 samples converged from 14 of 14 random starts, 50 failed. With 10, five
    # instead of seven of ten runs of a stiff reaction of eight species (HIRES) arrive.
    growth = max(sorted(growth_rates)[QUARTILE] * step, 1e-12)
    segment = model.method.segment or int(np.clip(2 / growth, 5, 10))
    return integrator.substeps or max(counts[0], sorted(counts)[QUARTILE]), segment


def drawn_parameters(problem: Problem) -> Array:
    """Return vectors of all declared parameters: at the starts, then drawn from the boxes."""
    random = np.random.default_rng(0)
    drawn = []
    for k in range(DRAWS):
        outside = {
            name: p.start if k == 0 or p.fixed else p.draw(random)
            for name, p in problem.parameters.items()
        }
        drawn.append([*problem.local_values(outside).values()])

    return np.array(drawn, dtype=float).reshape(DRAWS, -1)
