"""Streams that do not take every text."""

import errno
import io
import os

import pytest

from greybox.cli.terminal import _spelled, colored, has_all_characters, make_writable, write


def stream(encoding, monkeypatch):
    """Standard output into memory, in an encoding."""
    made = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="\n")
    monkeypatch.setattr("sys.stdout", made)
    make_writable()
    return made


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [
        ("utf-8", "ã3 = 8 ± 1 rad/s² → ω, µ \\udcff"),
        ("cp1252", "ã3 = 8 ± 1 rad/s² -> omega, µ \\udcff"),
        ("latin-1", "ã3 = 8 ± 1 rad/s² -> omega, µ \\udcff"),
        ("ascii", "a3 = 8 +- 1 rad/s^2 -> omega, u \\udcff"),
    ],
)
def test_what_an_encoding_does_not_have_is_spelled(monkeypatch, encoding, shown):
    out = stream(encoding, monkeypatch)
    assert write("ã3 = 8 ± 1 rad/s² → ω, µ \udcff", out) == ""
    assert out.buffer.getvalue().decode(encoding) == shown + "\n"
    assert has_all_characters(out) == (encoding == "utf-8")


class Broken(io.StringIO):
    def __init__(self, error):
        super().__init__()
        self.error = error

    def flush(self):
        raise self.error


def test_what_stands_in_the_way_is_returned():
    assert write("text", None) == ""
    assert write("text", Broken(BrokenPipeError())) == ""
    assert (
        write("text", Broken(OSError(errno.ENOSPC, "No space left on device")))
        == "No space left on device"
    )


@pytest.mark.skipif(os.name == "nt", reason="Windows has no TERM")
@pytest.mark.parametrize(("term", "colors"), [("xterm", True), ("dumb", False), (None, False)])
def test_colors_are_for_terminals_that_say_what_they_are(monkeypatch, term, colors):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.delenv("TERM", raising=False)
    if term:
        monkeypatch.setenv("TERM", term)
    out = io.StringIO()
    monkeypatch.setattr(out, "isatty", lambda: True)
    assert (colored("FAILED: why", out) != "FAILED: why") == colors


def test_what_cannot_be_read_is_not_spelled():
    error = UnicodeDecodeError("ascii", b"\xff", 0, 1, "ordinal not in range")
    with pytest.raises(UnicodeDecodeError):
        _spelled(error)
