"""Grids of members, in Python."""

import numpy as np
import pytest

import greybox as gb
from greybox.models.rate import DampedAngle
from greybox.models.tilt import Tilt
from greybox.problems import pitch_hover

FIRST = pitch_hover.data()
SECOND = gb.FrequencyResponse(FIRST.omega, 2 * FIRST.response, FIRST.input, FIRST.output)


def test_every_argument_multiplies_and_names_say_what_differs():
    members = gb.study.grid(
        [Tilt(), DampedAngle()],
        FIRST,
        criterion=[gb.RelativeError(), gb.MagnitudePhase()],
        seed=[0, 1],
        fix={"T_delay": 0.004},
        starts=5,
    )
    assert len(members) == 2 * 2 * 2
    assert members[0].name == "pitch hover: Tilt, relative-error, seed 0"
    assert members[-1].name == "pitch hover: DampedAngle, magnitude-phase, seed 1"
    assert len({member.name for member in members}) == 8
    for member in members:
        assert member.problem.fixed_values == {"T_delay": 0.004}
        assert (member.starts, member.start_count) == (5, 5)
    assert [m.seed for m in members[:2]] == [0, 1]
    assert members[2].problem.criterion == gb.MagnitudePhase()


def test_data_are_values_files_or_joint_fits(tmp_path):
    for k, response in enumerate((FIRST, SECOND)):
        gb.data.write_response(response, tmp_path / f"f{k}.csv")
    files = gb.study.grid(Tilt(), str(tmp_path / "*.csv"), joint=str(tmp_path / "*.csv"))
    assert [m.name for m in files] == ["f0", "f1", "f0+f1"]
    values = gb.study.grid(Tilt(), [FIRST, SECOND, (FIRST, SECOND)])
    assert [len(m.problem.parts) for m in values] == [1, 1, 2]
    for member, file in zip(values, files, strict=True):
        for part, read in zip(member.problem.parts, file.problem.parts, strict=True):
            np.testing.assert_allclose(read.data.response, part.data.response)
    assert len({m.name for m in values}) == 3
    problems = gb.study.grid(problem=[pitch_hover.problem()], band=[(1, 9), (2, 30)])
    assert [m.name.split(": ")[1] for m in problems] == ["band 1 9", "band 2 30"]
    assert max(problems[0].problem.data.omega) <= 9


def test_what_a_grid_cannot_mean_is_a_sentence():
    with pytest.raises(ValueError, match=r"has no key 'seeds'; .*mean 'seed'"):
        gb.study.grid(Tilt(), FIRST, seeds=[0])
    with pytest.raises(ValueError, match="needs data"):
        gb.study.grid(Tilt())
    for key, empty in {"seed": {"seed": []}, "data": {"held": FIRST}}.items():
        with pytest.raises(ValueError, match=f"{key} is empty: give at least one value"):
            gb.study.grid(Tilt(), FIRST, **empty)


class Declared(gb.Starts):
    """The declared starts, by a rule that states no number."""

    def __str__(self):
        return "as declared"

    def draw(self, parameters):
        return np.array([[parameter.start for parameter in parameters.values()]])


def test_the_default_number_of_starts():
    assert gb.study.Member(pitch_hover.problem()).start_count == 200
    for starts, count in (
        ([{}, {}], 2),
        ([gb.solve.Sobol(50), {}], 51),
        (gb.solve.Sobol(9), 9),
        (1e3, 1000),
        (Declared(), 1),
    ):
        assert gb.study.Member(pitch_hover.problem(), starts).start_count == count


def test_a_file_that_cannot_be_read_fails_alone_and_is_tried_again(tmp_path):
    good, bad = tmp_path / "good.csv", tmp_path / "lost.csv"
    gb.data.write_response(FIRST, good)
    bad.write_bytes(bytes(range(256)))

    def batch(folder):
        members = gb.study.grid(Tilt(), [str(good), str(bad)], starts=2)
        return gb.batch(members, tmp_path / folder, progress=False)

    study = batch("study")
    assert [member.status for member in study.members] == ["done", "failed"]
    assert "lost.csv" in study["lost"].error
    gb.data.write_response(SECOND, bad)
    assert batch("study").count("done") == 2
    bad.write_bytes(b"")  # the answer of the file that could be read remains
    assert batch("study").count("done") == 2
    good.write_bytes(b"")
    with pytest.raises(ValueError, match=r"good\.csv"):
        batch("none")
