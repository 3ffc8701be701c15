"""Streams that do not take every text."""

import errno
import io

import pytest

from greybox.cli.terminal import make_writable, write


def stream(encoding, monkeypatch):
    """Standard output into memory, in an encoding."""
    made = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="\n")
    monkeypatch.setattr("sys.stdout", made)
    make_writable()
    return made


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [
        ("utf-8", "8 ± 1 → \\udcff"),
        ("cp1252", "8 ± 1 \\u2192 \\udcff"),
        ("ascii", "8 \\xb1 1 \\u2192 \\udcff"),
    ],
)
def test_every_encoding_takes_every_text(monkeypatch, encoding, shown):
    out = stream(encoding, monkeypatch)
    assert write("8 ± 1 → \udcff", out) == ""
    assert out.buffer.getvalue().decode(encoding) == shown + "\n"


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
