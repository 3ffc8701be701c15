"""A small measured frequency response, with and without what may be known beside it."""

import numpy as np

import greybox as gb

OMEGA = [1.0, 2.0, 4.0]
RESPONSE = [1 + 1j, 0.5j, -0.1 + 0.02j]
EXTRAS = {
    "coherence": [1.0, 0.9, 0.5],
    "variance": [0.1, 0.02, 1e-5],
    "dof": [18.0, 18.0, 10.0],
    "common_errors": [[0.1j, 0.1, 1e-3], [0.2, -0.01j, 1e-3 + 1e-3j]],
}


def measured(**words):
    return gb.FrequencyResponse(
        **{"omega": OMEGA, "response": RESPONSE, "input": "u", "output": "theta"} | words
    )


def columns(response):
    return [getattr(response, c) for c in ("omega", "response", *EXTRAS)]


def assert_same(a, b):
    assert all(np.array_equal(x, y) for x, y in zip(columns(a), columns(b), strict=True))
