"""A long record with fewer samples, whose test takes less time."""

import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.compiled.disturbances import DisturbedRecord
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_part import RecordPart

# Samples of an output in a stretch: of fewer, straight lines and an autoregression leave nothing.
FEWEST = 8
# Share of what an output moves that a simulation by larger steps may miss: so little do terms
# differ.
MISSED = 0.1


@np.errstate(all="ignore")  # by larger steps, a simulation may diverge
def shortened(part: RecordPart, trajectory: Trajectory, most: int) -> DisturbedRecord:
    """Return a record, a longer one with so many samples.

    If a motion is much slower than the samples, means of some residuals suffice, which show slow
    effects over the whole record; other records are cut to excerpts.
    """
    if part.samples <= most:
        return DisturbedRecord(part, trajectory)

    def chosen(shorter: RecordPart, values: Array) -> Array:
        rows = np.zeros((len(values), len(part.model.record)))
        for stretch, row in zip(part.data.stretches, part.data.unpadded(values), strict=True):
            rows[:, stretch.own_rows] = row[:, stretch.own]
        return shorter.data.at_samples(rows)

    def along(shorter: RecordPart) -> Trajectory:
        states = chosen(shorter, part.segments.in_order(trajectory.states))
        nodes = states[:, :: shorter.data.segment_length].T
        return shorter.trajectory(trajectory.z, nodes)

    outputs = part.simulated_outputs(trajectory)
    residuals = part.with_outputs(part.data.unpadded(part.data.measured - outputs)).data
    held = np.array([between.held for between in part.model.between])
    coarse = part.with_data(residuals.averaged(-(-part.samples // most), held))
    simulated = coarse.simulated_outputs(along(coarse))
    missed = np.std(simulated - chosen(coarse, outputs), axis=1)
    is_slow = np.all(missed < MISSED * np.std(outputs, axis=1))
    # Short stretches, which lose their last mean, would have too few samples.
    is_long = np.mean([len(stretch) for stretch in coarse.data.stretches]) - 1 >= FEWEST
    # The gains of a predictor belong to its step.
    if part.gains or not (is_slow and is_long):
        excerpt = part.excerpt(most)
        return DisturbedRecord(excerpt, along(excerpt))

    means = coarse.data.measured
    pieces = coarse.data.unpadded(means + simulated)
    for piece in pieces:
        # A mean of the few samples at the end would be early: slow errors would jump.
        piece[:, -1] = np.nan
    coarse = coarse.with_outputs(pieces)
    spread = np.nanstd(residuals.measured, axis=1) / np.nanstd(means, axis=1)
    return DisturbedRecord(coarse, along(coarse), spread[:, None])
