"""A criterion of a user's own: relative errors with Huber's function, linear beyond a threshold."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

import greybox as gb
from greybox.data.files.arrays import real_and_imaginary
from greybox.modeling.formulation.frequency_criteria import squared_magnitude, total


@dataclass(frozen=True)
class Huber(gb.Criterion):
    """Sum of Huber's function of the relative errors: Huber (1981), Robust Statistics, ch. 4."""

    threshold: float = 1.0
    rule: ClassVar[str] = "Huber's function of relative errors"
    smoothed: ClassVar[bool] = True

    def cost(self, model: Any, data: Any, smoothing: Any = 0.0) -> Any:
        error = (model - data.response) / np.abs(data.response)
        size = gb.sqrt(squared_magnitude(error) + smoothing)
        values = gb.where(
            size <= self.threshold, size**2 / 2, self.threshold * (size - self.threshold / 2)
        )
        return total(values)

    def jacobian(self, model: Any, sensitivity: Any, data: Any) -> Any:
        return real_and_imaginary(sensitivity / np.abs(data.response)[:, None])

    def spread(self, model: Any, data: Any, correction: float) -> Any:
        error = np.abs((model - data.response) / data.response)
        return 1.0, np.full(
            2 * len(data), np.mean(np.minimum(error, self.threshold) ** 2) / 2 * correction**2
        )
