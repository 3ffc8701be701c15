"""`greybox profile`: intervals of a saved fit."""

import json

from command_line import refused, run


def test_a_saved_fit_is_profiled(capsys, own, tmp_path):
    result = str(tmp_path / "yaw.h5")
    run(capsys, "fit", "yaw_hover", "--starts", "3", "--no-profiles", "--out", result)
    figure = tmp_path / "yaw.png"
    status, out, _ = run(capsys, "profile", result, "a2", "--plot", figure, "--json")
    assert status == 0
    assert figure.stat().st_size > 1000
    answer = json.loads(out)["profiles"]["a2"]
    assert "no upper limit up to the bound 2000" in answer["text"]
    assert answer["high"] is None
    assert 100 < answer["low"] < 170
    assert "has no quantity to profile 'a9'" in refused(capsys, "profile", result, "a9")
    scattered = ("profile", result, "--model", own(), "a2", "--model", own(), "a9", "--level", 0.9)
    assert "has no quantity to profile 'a9'" in refused(capsys, *scattered)
