"""`greybox plot`: the figures of a log."""

import json
from importlib.resources import files

from command_line import run

LOG = str(files("greybox.problems") / "data" / "sitl_pitch.BIN")


def test_a_log_is_drawn(capsys, tmp_path):
    out = tmp_path / "log.png"
    status, text, _ = run(capsys, "plot", LOG, "--out", out, "--json")
    answer = json.loads(text)
    assert status == 0
    assert answer["files"] == [str(out)]
    assert out.read_bytes().startswith(b"\x89PNG")
    status, _, err = run(capsys, "plot", LOG, "--out", out)
    assert status == 2
    assert "exists: give another name, or --force" in err
