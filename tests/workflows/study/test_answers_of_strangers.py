"""Answers of a stranger's study: checked when they are read, escaped wherever they are written."""

import copy
import csv
import io
import json
from functools import cache

import numpy as np
import pytest
from crafted_studies import put_answer
from declared_models import TWO_LAGS_OMEGA, Lag, measured

import greybox as gb
from greybox.assessment.printed import summary
from greybox.assessment.storage import to_bytes
from greybox.cli.main import main
from greybox.data.files.packed import packed
from greybox.reporting.plotting.study import estimates_figure, structures_figure
from greybox.workflows.study.answer import Answer
from greybox.workflows.study.members import add_members
from greybox.workflows.study.stored_runs import StoredRuns
from greybox.workflows.study.study import progress

PAYLOADS = (
    "\x1b]0;x\x07\x9b31m\u202e\u2028",
    "a\r\n\\input{/etc/passwd}",
    "=cmd|' /C calc'!A0",
    "+1+cmd",
    "-2+3",
    "@SUM(A1)",
    "\t=1",
    "\r=1",
    "<script>alert(1)</script>",
    "$\\frac{a$",
    "% &_#{}~^",
)
GONE = object()
WRONG = (
    None,
    "text",
    -1,
    1e308,
    True,
    [],
    {},
    [None],
    {"a": None},
    {"": 1.0},
    10**400,
    GONE,
    "",
    [[]],
)


@cache
def fitted():
    fit = gb.fit(
        gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA, {"K": 2.0}, noise=0.02)), starts=3
    )
    return summary(fit), to_bytes(fit)


def write(folder, **answers):
    """Store members with these answers, all with the same fit."""
    add_members(folder, list(answers))
    runs = StoredRuns(folder)
    for name, answer in answers.items():
        runs.begin(name)
        runs.finish(answer, b"" if "error" in answer else fitted()[1])
    runs.write()


def texts(study):
    """Everything that a study prints, with its figures made on the way."""
    structures_figure(study)
    estimates_figure(study, "cost")
    shown = [str(study), repr(study), study.to_csv(), study.to_latex(), progress(study)]
    comparison = gb.compare(study)
    return [*shown, study.failures, str(comparison), repr(comparison), *map(repr, study.members)]


def places(value, place=()):
    """Yield the places in an answer."""
    yield place
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value[:1])
        if isinstance(value, list)
        else ()
    )
    for key, item in items:
        yield from places(item, (*place, key))


def changed(answer, place, value):
    """Return an answer with another value at a place, or none."""
    answer = copy.deepcopy(answer)
    inner = answer
    for key in place[:-1]:
        inner = inner[key]
    if value is GONE:
        del inner[place[-1]]
    else:
        inner[place[-1]] = value
    return answer


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("seed", range(3))
def test_a_crafted_answer_is_refused_in_a_sentence_or_printed(tmp_path, seed):
    answer = fitted()[0]
    cases = [(place, value) for place in places(answer) if place for value in WRONG]
    for k in np.random.default_rng(seed).permutation(len(cases))[:25]:
        folder = tmp_path / str(k)
        folder.mkdir()
        write(folder, sound=answer, crafted=changed(answer, *cases[k]))
        try:
            study = gb.study.read_study(folder, [Lag])
            texts(study)
        except ValueError as error:
            sentence = str(error)
        else:
            continue
        assert "'crafted'" in sentence, cases[k]
        assert str(folder) in sentence
        assert sentence.isprintable()


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "null",
        "[" * 5000,
        '{"cost": NaN}',
        '{"error": 1e999}',
        '{"error": "a"',
        '{"error": ["a"]}',
        '{"error": "' + "a" * 20_000 + '"}',
        '{"cost": ' + "9" * 5000 + "}",
        "\udcff".encode("utf-8", "surrogatepass"),
    ],
)
def test_a_text_that_is_no_answer_is_refused_in_a_sentence(tmp_path, text):
    write(tmp_path, one={"error": "no start"})
    put_answer(tmp_path, packed(text if isinstance(text, bytes) else text.encode()))
    with pytest.raises(ValueError, match=r"answer of 'one' in .*study\.sqlite is damaged"):
        gb.study.read_study(tmp_path)


def test_the_fit_of_another_member_is_refused(tmp_path):
    answer = fitted()[0]
    write(tmp_path, one=answer | {"checksum": "0" * 8})
    with pytest.raises(ValueError, match=r"fit of 'one' in .* is not that of the answer"):
        _ = gb.study.read_study(tmp_path, [Lag]).members[0].fit


def escaped(value, payload):
    """Return an answer all of whose texts are a payload."""
    if isinstance(value, str):
        return payload
    if isinstance(value, dict):
        return {key: escaped(item, payload) for key, item in value.items()}
    return [escaped(item, payload) for item in value] if isinstance(value, list) else value


def require_harmless(text):
    """No line of a text has a control character, which a terminal would obey."""
    lines = text.replace("\r\n", "\n").replace("\t", " ").split("\n")
    assert [line for line in lines if not line.isprintable()] == []


def require_tables(study):
    """No cell of the tables is a formula, and no line a command that is not of the table."""
    for row in csv.reader(io.StringIO(study.to_csv())):
        for cell in row:
            if cell.startswith(("=", "+", "-", "@", "\t", "\r")):
                assert np.isfinite(float(cell))

    for line in study.to_latex().splitlines():
        assert "\\input" not in line
        assert "\\frac" not in line
        assert line == "" or line[0] in "%\\" or line.endswith(r"\\")


@pytest.mark.parametrize("payload", PAYLOADS)
def test_no_text_of_an_answer_commands_anything(tmp_path, payload, capsys):
    answer = fitted()[0]
    crafted = escaped(answer, payload) | {n: answer[n] for n in ("checksum", "verdict")}
    failed = {"error": f"{payload} no", "model": [payload], "data": [payload]}
    write(tmp_path, sound=answer, **{f"={payload}": crafted, f"b{payload}": failed})
    study = gb.study.read_study(tmp_path, [Lag])
    for text in texts(study):
        require_harmless(text)
    require_tables(study)
    values = {row["parameter"]: row["value"] for row in csv.DictReader(io.StringIO(study.to_csv()))}
    assert float(values["K"]) == answer["estimate"]["K"]

    table, page = tmp_path / "table.csv", tmp_path / "page.html"
    assert main(["compare", str(tmp_path), "--csv", str(table)]) == 0
    shown = capsys.readouterr()
    require_harmless(shown.out + shown.err)
    gb.report(study, page)
    assert "<script>alert" not in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("payload", PAYLOADS)
def test_no_name_of_a_quantity_commands_anything(tmp_path, payload):
    answer = copy.deepcopy(fitted()[0])
    for field, value in (("derived", -1.5), ("standard_error", 0.1), ("unit", payload)):
        answer[field][payload] = value
    write(tmp_path, one=answer)
    study = gb.study.read_study(tmp_path, [Lag])
    require_harmless(str(study))
    require_tables(study)
    assert "-1.5" in study.to_csv()


def test_every_field_of_a_summary_is_declared():
    answer = json.loads(json.dumps(fitted()[0]))
    assert answer.keys() <= Answer.__annotations__.keys() | Answer.__required_keys__
