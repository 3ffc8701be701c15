"""Files of a user's own, and a saved fit with its controller."""

import sys

import pytest
from command_line import OWN
from saved_rate_loop import saved_rate_loop


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


@pytest.fixture
def few_structures(monkeypatch):
    """Let `identify` try three structures, where the claim does not depend on them."""
    for name, most in (("POLES", 1), ("ZEROS", 0), ("INTEGRATORS", 1)):
        monkeypatch.setattr(f"greybox.workflows.identification.orders.{name}", most)


@pytest.fixture(scope="session")
def rate_loop(tmp_path_factory):
    """Return the arguments of a saved fit and of its controller."""
    return saved_rate_loop(tmp_path_factory.mktemp("fits"))
