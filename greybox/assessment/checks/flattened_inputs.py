"""Whether lines between the samples of an input attenuate it."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings


def flattened_inputs(evidence: Evidence) -> Findings:
    """Name inputs of a limited band that lines between samples attenuate."""
    for part, _ in evidence.records:
        stretch = max(part.data.stretches, key=len)
        is_uniform = part.model.has_time and stretch.times is None
        if not is_uniform or part.model.criterion.inputs == "linear":
            continue
        for name, between, values in zip(
            part.system.inputs, part.model.between, stretch.inputs, strict=True
        ):
            power = np.abs(np.fft.rfft(np.hanning(values.size) * (values - values.mean()))) ** 2
            rate = np.fft.rfftfreq(values.size)
            # Steps and corners have power at all frequencies: they are lines, or held.
            if between.held or power[rate > 0.3].sum() >= 1e-3 * power.sum():
                continue
            # Lines through samples are these samples, each a triangle: its spectrum is sinc².
            lost = power @ (1 - np.sinc(rate) ** 4) / power.sum()
            # A multisine up to 0.2 of the sampling rate loses 9 %, a sweep up to a tenth of it 2 %.
            if lost > 0.04:
                yield Finding(
                    f"{name} moves fast for its sampling rate: lines between its samples lose "
                    f"{100 * lost:.1f} % of its power, which shifts the estimates. Give it at a "
                    "higher rate (interpolated by its band, as by scipy.signal.resample), with "
                    "outputs NaN in between, or state its hold; inputs='linear' states that it "
                    "varies in straight lines.",
                    f"{name} flattened",
                    part.name,
                )
