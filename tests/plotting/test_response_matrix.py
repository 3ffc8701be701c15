"""Matrices of responses: each pair in its place, over one range."""

import numpy as np
import pytest

import greybox as gb
from greybox.plotting.response_matrix import response_matrix


def response(output, name, low, high, gain):
    return gb.FrequencyResponse(np.geomspace(low, high, 5), np.full(5, gain + 0j), name, output)


def test_every_pair_has_its_place_and_missing_ones_are_blank():
    given = [
        response("p", "da", 1, 20, 0.1),
        response("p", "dr", 2, 90, 10),
        response("r", "dr", 0.5, 8, 100),
    ]
    axes = response_matrix(given).reshape(4, 2)
    decibel = {(i, j): axes[i, j].get_lines()[0].get_ydata() for i, j in ((0, 0), (0, 1), (2, 1))}
    assert {
        where: pytest.approx(np.full(5, v))
        for where, v in {(0, 0): -20, (0, 1): 20, (2, 1): 40}.items()
    } == decibel
    assert [axes[i, j].axison for i, j in ((2, 0), (3, 0), (2, 1), (3, 1))] == [
        False,
        False,
        True,
        True,
    ]
    assert [axes[0, j].get_title() for j in (0, 1)] == ["da to p", "dr to p"]
    assert [[axes[i, j].get_ylabel() for j in (0, 1)] for i in (0, 1)] == [
        ["|.|, dB", ""],
        ["∠, °", ""],
    ]
    assert [axes[3, 1].get_xlabel(), axes[1, 1].get_xlabel()] == ["ω, rad/s", ""]
    low, high = axes[0, 0].get_xlim()
    assert 0.3 < low <= 0.5
    assert 90 <= high < 200
    assert axes[3, 1].get_xlim() == (low, high)


def test_more_outputs_and_inputs_take_more_room():
    def size(*pairs):
        axes = response_matrix([response(output, name, 1, 9, 1) for output, name in pairs])
        return axes[0].figure.get_size_inches()

    one = size(("p", "da"))
    assert np.all(one > 1)
    assert size(("p", "da"), ("p", "dr")) / one == pytest.approx([1.8, 1], abs=0.15)
    assert size(("p", "da"), ("r", "da"), ("q", "da")) / one == pytest.approx([1, 2.7], abs=0.2)


def test_what_is_no_response_is_refused():
    with pytest.raises(ValueError, match="there is no response to draw: give at least one"):
        response_matrix([])
    with pytest.raises(TypeError, match="cannot draw 3: give FrequencyResponses"):
        response_matrix([response("p", "da", 1, 9, 1), 3])
