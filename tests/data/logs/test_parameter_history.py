"""Changes of parameters, in effect during a test."""

import pytest

from greybox.data.logs.parameter_history import parameter_changes
from greybox.data.record import Recording
from greybox.models.firmware import parameters_during

WRITTEN = ((0, "P", 0.1), (0, "I", 0.2), (1, "P", 0.1), (5, "P", 0.3), (8, "I", 0.25))


def test_a_parameter_written_twice_with_one_value_did_not_change():
    assert parameter_changes(WRITTEN) == ((5, "P", 0.1, 0.3), (8, "I", 0.2, 0.25))


def test_parameters_are_those_of_the_time_of_the_test():
    metadata = {
        "parameters": {"P": 0.3, "I": 0.25},
        "parameter_changes": parameter_changes(WRITTEN),
    }
    log = Recording({}, metadata=metadata)
    assert parameters_during(log, 2, 4, ["P", "I"]) == {"P": 0.1, "I": 0.2}
    assert parameters_during(log, 6, 7, ["P", "I"]) == {"P": 0.3, "I": 0.2}
    assert parameters_during(log, 7, 9, ["P"]) == {"P": 0.3, "I": 0.2}
    with pytest.raises(ValueError, match=r"I from 0.2 to 0.25 at 8.0 s"):
        parameters_during(log, 7, 9, ["I"])
