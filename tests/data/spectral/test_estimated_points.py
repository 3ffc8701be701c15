import numpy as np
import pytest

from greybox.data.frequency_response import FrequencyResponse, Stretch
from greybox.data.record import Record
from greybox.data.spectral.estimated_points import EstimatedPoints, response_at, without_incoherent
from greybox.data.spectral.uniform_stretches import UniformStretch


def points(*kinds):
    k = np.arange(len(kinds))
    variance = np.where([bool(kind) for kind in kinds], np.nan, 0.1 * (k + 1))
    weak = np.array([kind == "weak" for kind in kinds])
    return EstimatedPoints(1.0 + k, 2 + 1j * k, variance, 8.0 + k, 0.5 + 0.1 * k, weak)


def test_what_could_be_estimated_is_collected_with_where_it_comes_from():
    origin = Stretch("x", 1.0, 2.0)
    signals = {name: np.zeros(2) for name in "uyz"}
    stretches = [
        UniformStretch(
            np.zeros((2, 2)), 0.1, origin, Record(np.arange(2.0), signals, units, source=source)
        )
        for source, units in (
            ("a.bin", {"u": "N", "y": "", "z": "m"}),
            ("b.bin", {"y": "m"}),
            ("a.bin", {}),
        )
    ]
    found = response_at(points("", "weak", "", "lost", "weak"), stretches, "u", "y", "name")
    np.testing.assert_allclose(found.omega, [1, 3])
    np.testing.assert_allclose(found.response, [2, 2 + 2j])
    np.testing.assert_allclose(found.variance, [0.1, 0.3])
    np.testing.assert_allclose(found.dof, [8, 10])
    np.testing.assert_allclose(found.coherence, [0.5, 0.7])
    assert (found.input, found.output, found.name, found.source) == (
        "u",
        "y",
        "name",
        "a.bin, b.bin",
    )
    assert list(found.stretches) == [origin, origin, origin]
    assert dict(found.units) == {"u": "N"}
    unstated = {"hold of the input not stated; sampling interval, s": "0.1"}
    assert found.about == unstated | {
        "dropped": "2 of 5 points, where the instrument hardly moves u, at 2 to 5 rad/s"
    }
    one = response_at(points("", "weak"), stretches, "u", "y", "")
    assert one.about == unstated | {
        "dropped": "1 of 2 points, where the instrument hardly moves u, at 2 rad/s"
    }
    assert response_at(points("", "lost"), stretches, "u", "y", "").about == unstated
    with pytest.raises(ValueError, match="the instrument hardly moves u"):
        response_at(points("weak", "lost"), [], "u", "y", "")
    with pytest.raises(ValueError, match="no frequency has enough data"):
        response_at(points("lost", "lost"), [], "u", "y", "")


def test_points_of_a_coherence_below_six_tenths_are_left_out_unless_all_are():
    omega = np.arange(1.0, 5.0)

    def response(coherence, **about):
        columns = {"coherence": np.array(coherence), "variance": np.full(4, 0.01)}
        return FrequencyResponse(omega, np.ones(4), **columns, about=about)

    left = without_incoherent(response([0.59, 0.6, 0.9, 0.2]))
    assert left.omega.tolist() == [2, 3]
    assert (
        left.about["dropped"]
        == "2 of 4 points, with a coherence below 0.6, or too uncertain at an end, at 1 to 4 rad/s"
    )
    left = without_incoherent(response([0.9, 0.3, 0.9, 0.9], dropped="a", test="b"))
    assert left.about == {
        "dropped": "a; 1 of 4 points, with a coherence below 0.6, or too uncertain at an end, at 2 rad/s",
        "test": "b",
    }
    for same in ([0.1, 0.2, 0.3, 0.4], [0.6, 0.7, 0.8, 0.9]):
        whole = response(same)
        assert without_incoherent(whole) is whole


@pytest.mark.parametrize(
    ("magnitude", "kept"),
    [
        ([90, 40, 1, 1.2, 1, 2, 30], [3, 4, 5]),  # noise makes the ends large
        ([1, 1, 1, 0.01, 1, 1, 1], [1, 2, 3, 4, 5, 6, 7]),  # a notch is no end
        ([0.1] * 7, [1, 2, 3, 4, 5, 6, 7]),  # of nothing certain all is shown
    ],
)
def test_ends_are_left_out_while_their_error_is_half_of_their_neighbor(magnitude, kept):
    error = np.array([60, 20, 0.1, 0.1, 0.1, 2, 25]) if magnitude[0] > 1 else np.full(7, 0.1)
    columns = {"coherence": np.full(7, 0.9), "variance": error**2}
    whole = FrequencyResponse(np.arange(1.0, 8.0), np.array(magnitude, dtype=float), **columns)
    assert without_incoherent(whole).omega.tolist() == kept
