"""Numbers as JSON has them."""

import json

import numpy as np

from greybox.data.files.json_numbers import finite, plain


def test_what_is_not_finite_is_null():
    values = {"a": 1.5, "b": np.nan, "c": -np.inf, "d": np.float64(2)}
    assert json.loads(json.dumps(plain(values), allow_nan=False)) == {
        "a": 1.5,
        "b": None,
        "c": None,
        "d": 2.0,
    }
    assert type(finite(np.float64(2))) is float
