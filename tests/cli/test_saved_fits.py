"""Commands that read saved fits know models of one's own when they are given their file."""

import json

import pytest
from command_line import QUICK, refused, run


@pytest.mark.parametrize(
    "command",
    [
        ("profile", "fit.h5", "K"),
        ("bootstrap", "fit.h5", "--replicates", "4"),
    ],
    ids=lambda command: command[0],
)
def test_models_of_ones_own_are_given_by_their_file(capsys, own, tmp_path, command):
    name = own()
    text = (
        (tmp_path / name)
        .read_text()
        .replace("omega + 1))", "omega + 1) * (1 + 0.01 * np.cos(omega)))")
    )
    (tmp_path / name).write_text(text)  # fitted exactly, it has no errors
    run(capsys, "fit", name, "--out", "fit.h5", "--quiet", *QUICK)
    run(capsys, "fit", name, "--fix", "T=0.19", "--out", "fixed.h5", "--quiet", *QUICK)
    assert "was not found" in (sentence := refused(capsys, *command))
    assert sentence.endswith("or those given (none): give its class or file, --model my.py.\n")
    status, out, _ = run(capsys, *command, "--model", name, "--json")
    assert status == 0
    assert json.loads(out)
