"""`greybox compare` of saved fits."""

import json

from command_line import refused, run

QUICK = ("--starts", "3", "--no-profiles")


def test_saved_fits_are_compared(capsys, tmp_path):
    paths = {name: str(tmp_path / f"{name}.h5") for name in ("four", "three", "other")}
    run(capsys, "fit", "yaw_hover", *QUICK, "--out", paths["four"])
    run(capsys, "fit", "yaw_hover", "--fix", "a4=0", *QUICK, "--out", paths["three"])
    run(capsys, "fit", "pitch_hover", *QUICK, "--out", paths["other"])
    status, out, _ = run(capsys, "compare", paths["four"], paths["three"])
    assert status == 0
    assert "four (4 free) is supported" in out

    status, out, _ = run(capsys, "compare", paths["four"], paths["three"], "--json")
    answer = json.loads(out)
    assert answer["supported"] == "four"
    assert {"measure", "values"} <= answer["table"][0].keys()
    assert "other was fitted to other data" in refused(
        capsys, "compare", paths["four"], paths["other"]
    )
    assert "there is one fit" in refused(capsys, "compare", paths["four"])
    assert "is given twice" in refused(capsys, "compare", paths["four"], paths["four"])
