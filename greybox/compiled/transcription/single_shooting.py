"""Single shooting: only the initial states are unknown, everything else is simulated from them."""

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from greybox.compiled.sample_step import SampleStep
from greybox.compiled.sampled_data import Experiment
from greybox.compiled.transcription.method import Transcribed, Transcription


@dataclass(frozen=True)
class SingleShooting(Transcription):
    """The whole record simulated from its first sample: few unknowns, but nothing for an unstable plant.

    Source: Schittkowski (2002), Numerical Data Fitting in Dynamical Systems, chapter 4.

    Parameters
    ----------
    segment, integrator, hessian
        See `Transcription`.
    """

    label: ClassVar[str] = "single shooting"

    def transcribe(self, step: SampleStep, experiment: Experiment, q: ca.MX, data: Any) -> Transcribed:
        """Return the initial states; there are no equations."""
        n, counts = step.function.size1_in(0), experiment.counts
        initial = ca.MX.sym("initial", n, len(counts))
        residuals, at = [], 0
        for k, count in enumerate(counts):
            size = count * experiment.segment
            follow = step.function.mapaccum("stretch", size)
            residuals.append(follow(initial[:, k], q, data[:, at : at + size])[1])
            at += size
        first = (np.cumsum([0, *counts[:-1]]) * experiment.segment).tolist()
        return Transcribed(
            unknowns=ca.vec(initial),
            residuals=ca.horzcat(*residuals),
            equations=ca.MX(0, 1),
            initial=initial,
            start=lambda states: states[:, first].ravel(order="F"),
        )
