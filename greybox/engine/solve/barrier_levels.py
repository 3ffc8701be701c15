"""The levels through which a search passes: factors of its barrier, and smoothings of its cost."""

import numpy as np

from greybox.engine.compiled.response_part import SMOOTHING

# Factors of the barrier, and smoothings of a cost with kinks, one level after the other. The first
# smoothing rounds off what is smaller than the measured response. Without a barrier 81 % instead of
# all of the searches for the yaw axis of the paper reach its minimum, and 15 instead of 60 % of
# those for two resonances with a delay. But a strong barrier misses minima at a bound: of the
# searches for the pitch axis at 5° with its drag free, which is zero at the minimum, 0.5 % find it
# with a first factor of 1, and 96 % with 0.01 (IPOPT 22 %). So every second search has a weak
# barrier.
BARRIERS = np.array([[1.0, 1e-2, 1e-4, 0.0], [1e-2, 1e-3, 1e-4, 0.0]])

SMOOTHINGS = np.array([1.0, 1e-2, 1e-4, SMOOTHING])

LAST = BARRIERS.shape[1] - 1
