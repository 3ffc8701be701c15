"""A long record with fewer samples, whose test takes less time."""

from dataclasses import replace

import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.compiled.disturbances import DisturbedRecord
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.sampled_data import SampledData

# Samples of an output in a stretch: of fewer, straight lines and an autoregression leave nothing.
FEWEST = 8
# Share of what an output moves that a simulation by larger steps may miss: so little do terms
# differ.
MISSED = 0.1


@np.errstate(all="ignore")  # by larger steps, a simulation may diverge
def shortened(part: RecordPart, trajectory: Trajectory, most: int) -> DisturbedRecord:
    """Return a record, a longer one with so many samples.

    If a motion is much slower than the samples, means of some residuals suffice, which show slow
    effects over the whole record. Other records are cut to excerpts, which must be long against the
    motion: feedback returns noise as inputs, and where an initial state and a drift are fitted to a
    second of a flight, they contain the noise that later inputs return. Of right models of flights
    at 400 Hz, a third were called wrong by excerpts of one second, and none by means.
    """
    if part.samples <= most:
        return DisturbedRecord(part, trajectory)

    def chosen(data: SampledData, values: Array) -> Array:
        rows = np.zeros((len(values), len(part.model.record)))
        for stretch, row in zip(part.data.stretches, part.data.unpadded(values), strict=True):
            rows[:, stretch.own_rows] = row[:, stretch.own]
        return data.at_samples(rows)

    def along(shorter: RecordPart) -> Trajectory:
        states = chosen(shorter.data, part.segments.in_order(trajectory.states))
        nodes = states[:, :: shorter.data.segment_length].T
        return shorter.trajectory(trajectory.z, nodes)

    outputs = part.simulated_outputs(trajectory)
    residuals = part.with_outputs(part.data.unpadded(part.data.measured - outputs)).data
    held = np.array([between.held for between in part.model.between])
    count = -(-part.samples // most)
    averaged = residuals.averaged(count, held)
    means, expected = averaged.measured, chosen(averaged, outputs)
    stretches = tuple(
        replace(stretch, outputs=values)
        for stretch, values in zip(
            averaged.stretches, averaged.unpadded(means + expected), strict=True
        )
    )
    for stretch in stretches:
        # A mean of the few samples at the end would be early: slow errors would jump.
        stretch.outputs[:, -1] = np.nan
    coarse = part.of_means(replace(averaged, stretches=stretches), count)
    course = along(coarse)

    missed = np.std(coarse.simulated_outputs(course) - expected, axis=1)
    is_slow = np.all(missed < MISSED * np.std(outputs, axis=1))
    # Short stretches, which lose their last mean, would have too few samples.
    is_long = np.mean([len(stretch) for stretch in stretches]) - 1 >= FEWEST
    if not (is_slow and is_long):
        excerpt = part.excerpt(most)
        return DisturbedRecord(excerpt, along(excerpt))

    spread = np.nanstd(residuals.measured, axis=1) / np.nanstd(means, axis=1)
    record = DisturbedRecord(coarse, course, spread[:, None])
    # Those of the samples, without the errors of larger steps.
    record.residuals = np.where(np.isfinite(coarse.data.measured), means, 0.0)
    return record
