"""Files of a user's own."""

import sys

import pytest
from command_line import OWN


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Write a user's own file, with a name that no other test used.

    Python keeps modules by name.
    """
    monkeypatch.chdir(tmp_path)
    own.number = getattr(own, "number", 0) + 1

    def write(text=OWN):
        path = tmp_path / f"own_{own.number}.py"
        path.write_text(text)
        return path.name

    yield write
    sys.modules.pop(f"own_{own.number}", None)
