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
    assert "there is 1 fit to compare" in refused(capsys, "compare", paths["four"])
    assert "there is 1 fit" in refused(capsys, "compare", paths["four"], paths["four"])


def test_the_estimates_of_a_study_are_written_as_tables(capsys, tmp_path, small_study):
    table, rows = tmp_path / "table.tex", tmp_path / "rows.csv"
    arguments = ("compare", small_study.folder, "--latex", table, "--csv", rows)
    status, out, _ = run(capsys, *arguments)
    assert status == 0
    assert f"wrote {table}" in out
    assert table.read_text(encoding="utf-8") == small_study.to_latex()
    assert rows.read_text(encoding="utf-8").splitlines() == small_study.to_csv().splitlines()
    assert "exists" in refused(capsys, *arguments)
    assert "for a study" in refused(capsys, "compare", "a.h5", "b.h5", "--csv", tmp_path / "c.csv")
    status, out, _ = run(capsys, "batch", "--status", small_study.folder)
    assert status == 0
    assert "11 members: 10 done, 1 failed" in out
