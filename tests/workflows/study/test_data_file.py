"""Data files."""

import json
from importlib.resources import files

import numpy as np
import pytest
from command_line import refused, run

import greybox as gb
from greybox.models.drag import Drag
from greybox.models.tilt import Tilt
from greybox.workflows.study.data_file import read_data

pytestmark = pytest.mark.usefixtures("unjudged_file")

FLIGHT = files("greybox.problems") / "data" / "sitl_drag_hover.csv"
DRAG = ("fit", "--model", "drag:Drag", "--data")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("omega_rad_s,alpha,beta\n1,2,nan\n", "line 2: beta is 'nan'"),
        ("omega_rad_s,alpha,beta\n1,2,x\n", "line 2: beta is 'x'"),
        ("omega_rad_s,alpha,beta\n1,0,0\n2,1,1\n", "zero at omega = 1"),
        ("omega_rad_s,alpha,beta\n-1,1,0\n", "above 0 rad/s"),
        ("omega_rad_s,alpha,beta\n1,1,0\n1,1,0\n", "repeated"),
        ("omega_rad_s,alpha,beta\n1,1\n", "2 cells"),
        ("omega_rad_s,alpha,beta\n", "empty"),
        ("omega,alpha,beta\n1,1,1\n", "no column 'omega_rad_s'"),
        ("", "bad.csv is empty"),
        ("omega_rad_s,alpha,beta,coherence\n1,1,1,1.5\n", "coherence is 1.5"),
    ],
)
def test_bad_data_files(capsys, tmp_path, table, words):
    path = tmp_path / "bad.csv"
    path.write_text(table)
    assert words in refused(capsys, "fit", "--model", "rotor:Rotor", "--data", path)


def test_a_table_of_a_record_is_fitted_with_a_model_alone(capsys):
    answer = json.loads(run(capsys, *DRAG, FLIGHT, "--starts", "2", "--json", "--fix", "C_x=0")[1])
    fit = gb.fit(
        gb.Problem(Drag(), gb.read(FLIGHT)["sitl_drag_hover"], fixed={"C_x": 0.0}),
        starts=2,
        progress=False,
    )
    assert answer["outputs"][0]["output"] == "v"
    assert answer["cost"] == pytest.approx(fit.cost, rel=1e-9)
    assert answer["estimate"]["a5"] == pytest.approx(fit.estimate["a5"], rel=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "theta",
            "pitch",
            "no records with the signals of Drag (theta, v); it has data: pitch, v. To fit it, name "
            "the columns",
        ),
        (
            "time [s]",
            "when",
            "the dynamic model Drag needs samples in time, and data has rows without a time: give",
        ),
    ],
)
def test_a_table_that_is_no_record_of_the_model_is_a_sentence_with_the_way(
    capsys, tmp_path, old, new, words
):
    path = tmp_path / "data.csv"
    path.write_text(FLIGHT.read_text().replace(old, new))
    assert words in refused(capsys, *DRAG, path)


@pytest.mark.parametrize("cell", ["", "MANUAL"])
def test_a_column_without_numbers_is_named(capsys, tmp_path, cell):
    path = tmp_path / "data.csv"
    _, header, *rows = FLIGHT.read_text().replace("theta", "pitch").splitlines()
    path.write_text("\n".join([f"{header},theta", *(f"{row},{cell}" for row in rows)]))
    assert "columns without numbers were left out: theta. To" in refused(capsys, *DRAG, path)
    chosen = ("--columns", "time=time:s", "theta=theta:rad", "v=v")
    assert "has no numbers in the column 'theta'" in refused(capsys, *DRAG, path, *chosen)


def spelled(text):
    """Write a table with semicolons and decimal commas."""
    return text.replace(",", ";").replace(".", ",")


def test_a_table_with_decimal_commas_gives_the_same_fit(capsys, tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("# Flug 7; Böe\n" + spelled(FLIGHT.read_text()), encoding="latin-1")
    options = ("--starts", "1", "--json", "--fix", "C_x=0")
    expected = json.loads(run(capsys, *DRAG, FLIGHT, *options)[1])
    assert json.loads(run(capsys, *DRAG, path, *options)[1])["estimate"] == expected["estimate"]


def test_a_response_with_semicolons_is_recognized(capsys, tmp_path):
    path = tmp_path / "response.csv"
    omega = [0.5, 1.0, 2.0, 4.0, 8.0]
    values = [1 / (0.25j * w + 1) for w in omega]
    rows = [f"{w};{v.real:.9f};{v.imag:.9f}" for w, v in zip(omega, values, strict=True)]
    path.write_text(
        "# Böe\n" + spelled("omega_rad_s;alpha;beta\n" + "\n".join(rows)), encoding="latin-1"
    )
    options = ("--model", "polynomial:Polynomial(1, 0)", "--data", path, "--starts", "5", "--json")
    estimate = json.loads(run(capsys, "fit", *options)[1])["estimate"]
    assert list(estimate.values()) == pytest.approx([4.0, 4.0], rel=1e-5)


def test_angle_of_attack_and_sideslip_are_no_response(tmp_path):
    class Wind(gb.StateSpace):
        """A lag."""

        states, inputs, outputs = ("alpha",), ("beta",), ("alpha",)
        T = gb.Parameter(1.0, bounds=(0.1, 10), unit="s", about="lag")

        def derivative(self, x, u, p):
            return ((u.beta - x.alpha) / p.T,)

        def output(self, x, u, p):
            return (x.alpha,)

    path = tmp_path / "wind.csv"
    path.write_text("time [s],alpha,beta\n0,1,2\n1,3,4\n2,5,6\n")
    assert read_data(path, Wind())["beta"].tolist() == [2, 4, 6]


def test_rows_name_the_responses_of_one_input_and_two_outputs(tmp_path):
    class Cart(gb.StateSpace):
        """Its position and speed."""

        states, inputs, outputs = ("x", "v"), ("u",), ("x", "v")

        def derivative(self, x, u, p):
            return (x.v, u.u - x.v)

        def output(self, x, u, p):
            return (x.x, x.v)

    path = tmp_path / "both.csv"
    path.write_text("output,input,omega_rad_s,alpha,beta\nx,u,1,-0.5,-0.5\nv,u,1,0.5,-0.5\n")
    responses = read_data(path, Cart())
    assert [(each.input, each.output) for each in responses] == [("u", "x"), ("u", "v")]


def test_fit_says_of_a_record_what_inspect_says(capsys, tmp_path):
    lines = FLIGHT.read_text().splitlines()
    body = lines.index("time [s],theta [rad],v [m/s]") + 1
    for line, column, cell in ((40, 1, "fault"), (60, 2, "inf")):
        cells = lines[body + line].split(",")
        cells[column] = cell
        lines[body + line] = ",".join(cells)
    lines[body + 80] = lines[body + 80].partition(",")[0]
    path = tmp_path / "flight.csv"
    path.write_text("\n".join(lines).replace("[m/s]", "[pixels]"))
    found = json.loads(run(capsys, "inspect", path, "--json")[1])["findings"]
    for word in ("fewer cells", "'fault'", "'inf'", "1 gap, the longest 0.16 s"):
        assert word in " ".join(found)
    warnings = json.loads(run(capsys, *DRAG, path, "--starts", "1", "--json", "--fix", "C_x=0")[1])[
        "warnings"
    ]
    expected = [*found, "v was taken as it is, in 'pixels': the unit 'pixels' is not known."]
    assert sorted(w for w in warnings if w.startswith("data of")) == sorted(
        f"data of 'flight': {x}" for x in expected
    )


def test_a_log_with_many_messages_asks_for_a_problem_file(capsys):
    sentence = refused(capsys, *DRAG, files("greybox.problems") / "data" / "sitl_pitch.BIN")
    assert "no records with the signals of Drag (theta, v)" in sentence
    assert "in a file my.py whose function problem()" in sentence
    assert len(sentence) < 800


LINE = """
import greybox as gb

class Line(gb.StateSpace):
    inputs = ("x",)
    outputs = ("y",)
    a = gb.Parameter(1.0, starts=(-5, 5))
    b = gb.Parameter(0.5, starts=(-5, 5))

    def output(self, x, u, p):
        return (p.a + p.b * u.x,)
"""


def test_a_table_without_a_time_is_fitted_by_a_static_model(capsys, tmp_path):
    x = np.array([0.3, -1.0, 2.0, 0.7, 1.4, -0.2])
    y = 2 + 3 * x + np.array([0.1, -0.2, 0.05, 0.1, -0.1, 0.02])
    (tmp_path / "line.py").write_text(LINE)
    table = tmp_path / "table.csv"
    table.write_text("x,y\n" + "".join(f"{a},{b}\n" for a, b in zip(x, y, strict=True)))
    command = ("fit", "--model", tmp_path / "line.py:Line", "--data", table, "--starts", "2")
    answer = json.loads(run(capsys, *command, "--json", "--out", tmp_path / "line.h5")[1])
    A = np.vander(x, 2, increasing=True)
    q, squares, _, _ = np.linalg.lstsq(A, y, rcond=None)
    errors = np.sqrt(np.diag(np.linalg.inv(A.T @ A)) * squares[0] / 4)
    assert list(answer["estimate"].values()) == pytest.approx(q, rel=1e-6)
    assert list(answer["standard_error"].values()) == pytest.approx(errors, rel=1e-5)
    assert answer["warnings"] == []
    assert not gb.load(tmp_path / "line.h5").records[0].data.has_time
    assert "6 rows without a time" in run(capsys, *command)[1]
    assert gb.load(tmp_path / "line.h5").records[0].method.startswith("no integration")

    text = run(capsys, "inspect", table)[1]
    assert "no time column: rows in no order" in text
    message = json.loads(run(capsys, "inspect", table, "--json")[1])["messages"][0]
    assert (message["samples"], message["rate"], message["start"]) == (6, None, None)


def test_a_file_that_is_neither_response_nor_record_is_said(tmp_path):
    (tmp_path / "words.csv").write_text("some words\nand more of them\n")
    with pytest.raises(
        ValueError,
        match=r"words\.csv has no column of numbers",
    ):
        read_data(tmp_path / "words.csv", Tilt())


def test_angles_of_a_table_run_on_where_they_jumped(tmp_path):
    """As `gb.prepare` makes them: a heading of several turns, logged from -180 to 180 degrees."""
    time = np.arange(400) / 20
    heading = 0.9 * time + 0.2 * np.sin(time)  # rad
    logged = np.degrees((heading + np.pi) % (2 * np.pi) - np.pi)
    rows = [f"{t},{u},{theta}" for t, u, theta in zip(time, np.cos(time), logged, strict=True)]
    path = tmp_path / "heading.csv"
    path.write_text("\n".join(["time [s],u,theta [deg]", *rows]))
    record = read_data(path, Tilt())
    np.testing.assert_allclose(
        record["theta"] - record["theta"][0], heading - heading[0], atol=1e-9
    )
    prepared = gb.prepare(gb.read(path), {"theta": "heading.theta"})
    np.testing.assert_allclose(record["theta"], prepared["theta"], atol=1e-9)
