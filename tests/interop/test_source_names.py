"""Names of other languages are different and allowed there."""

import pytest

from greybox.interop.source_names import identifier


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("roll rate, 5°", "roll_rate_5"),
        ("__v__", "v"),
        ("2nd", "m_2nd"),
        ("°", "m"),
        ("", "m"),
        ("double", "double_"),
        ("lambda", "lambda_"),
        ("Double", "Double"),
    ],
)
def test_a_name_has_letters_digits_and_single_underscores(name, plain):
    assert identifier(name) == plain
