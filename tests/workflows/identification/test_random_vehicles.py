"""Random vehicles are identified by the default: a reduced form of `benchmarks/random_vehicles.py`."""

import numpy as np
import pytest
from benchmark_module import benchmark


@pytest.mark.parametrize("k", [47])
def test_a_random_vehicle_is_identified(k):
    vehicles = benchmark("random_vehicles")
    random = np.random.default_rng([1, k])
    outcome = vehicles.outcome(vehicles.vehicle(random), random)
    assert outcome.is_right, outcome.text
    assert outcome.explains
    assert outcome.error < 0.03
