"""Errors name file and line where they arose in a file of the user, and only there."""

import json
import site
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from greybox.data.files.error_place import error_place


def test_the_line_that_calls_a_package_is_named():
    with pytest.raises(ValueError, match="Expecting") as raised:
        json.loads("{")
    line = raised.traceback[0].lineno + 1
    assert error_place(raised.value) == f"test_error_place.py, line {line}: "


@pytest.mark.parametrize(
    "folder", [*site.getsitepackages(), site.getusersitepackages(), Path(json.__file__).parents[1]]
)
def test_errors_in_packages_have_no_place(folder):
    def of(path):
        with ThreadPoolExecutor() as pool:
            return error_place(pool.submit(exec, compile("\n1 / 0", path, "exec")).exception())

    assert of(f"{folder}/package.py") == ""
    assert of("/usr/src/app/mine.py") == "mine.py, line 2: "


def test_a_cell_of_a_notebook_has_no_number_as_its_name():
    with pytest.raises(ZeroDivisionError) as raised:
        exec(compile("\n1 / 0", "/tmp/ipykernel_77/1062490660.py", "exec"))
    assert error_place(raised.value) == "cell of the notebook, line 2: "


def test_a_file_that_is_not_python_names_its_line():
    with pytest.raises(SyntaxError) as raised:
        compile("a = (", "/home/me/mine.py", "exec")
    assert error_place(raised.value) == "mine.py, line 1: "
