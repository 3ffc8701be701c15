"""Dates and times of day in texts against the standard library."""

from datetime import datetime, timedelta

import numpy as np
import pytest

from greybox.data.dates import OF_DAY, SINCE_1970, seconds_in_texts

START = datetime(2026, 5, 12, 23, 59, 58)
MOMENTS = [START + timedelta(milliseconds=250 * k) for k in range(20)]
ELAPSED = 0.25 * np.arange(20)


@pytest.mark.parametrize(
    "form",
    [
        "%Y-%m-%dT%H:%M:%S.%f",
        "%Y-%m-%d %H:%M:%S.%f",
        "%Y-%m-%d %H:%M:%S,%f",
        "%Y/%m/%d %H:%M:%S.%f",
        "%d.%m.%Y %H:%M:%S.%f",
        "%Y-%m-%dT%H:%M:%S.%fZ",
        "%Y-%m-%d %H:%M:%S.%f+02:00",
    ],
)
def test_dates(form):
    times, unit = seconds_in_texts([moment.strftime(form) for moment in MOMENTS])
    assert unit == SINCE_1970
    np.testing.assert_allclose(times - times[0], ELAPSED, atol=1e-6)
    since_1970 = (START - datetime(1970, 1, 1)).total_seconds()
    assert times[0] == pytest.approx(since_1970, abs=1e-6)


@pytest.mark.parametrize("form", ["%H:%M:%S.%f", "%H:%M:%S,%f", "%I:%M:%S.%f %p", "%H:%M:%S:%f"])
def test_times_of_day(form):
    times, unit = seconds_in_texts([moment.strftime(form) for moment in MOMENTS])
    assert unit == OF_DAY
    np.testing.assert_allclose(times % 86400, (86398 + ELAPSED) % 86400, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("00:01.5", 1.5), ("1:02:03", 3723.0), ("0 days 00:00:00.020000", 0.02), ("27:00:00", 97200)],
)
def test_times_that_passed(text, seconds):
    assert seconds_in_texts([text])[0][0] == seconds


@pytest.mark.parametrize(
    "text", ["10:05", "05/01/2026 10:00:00", "noon", "12a", "1.2.3", "", "1-2"]
)
def test_other_texts_are_no_times(text):
    assert seconds_in_texts([text]) is None


def test_empty_texts_and_unlike_zones():
    times, _ = seconds_in_texts(["2026-05-12", "", "2026-05-13"])
    assert times[2] - times[0] == 86400
    assert np.isnan(times[1])
    assert seconds_in_texts(["2026-05-12T10:00:00Z", "2026-05-12T10:00:00+01:00"]) is None
