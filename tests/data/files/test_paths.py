"""What is no path is refused wherever a file is read."""

import pytest

import greybox as gb


@pytest.mark.parametrize("read", [gb.read, gb.load, gb.read_response, gb.data.read_responses])
@pytest.mark.parametrize("path", [3, None, ["a.csv"]])
def test_what_is_no_path_is_refused_with_its_value(read, path):
    with pytest.raises(TypeError, match=r"path is .*: give the name of a file"):
        read(path)
