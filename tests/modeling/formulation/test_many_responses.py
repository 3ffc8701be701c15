"""One model for many responses: a list, a matrix, a mapping or a file make the same sum."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb

OMEGA = np.geomspace(0.5, 20, 8)
TRUTH = {"Lp": -3.0, "Lv": -0.5, "Yv": -0.2, "Llat": 12.0, "Lped": 2.0}


class Roll(gb.StateSpace):
    """Sideslip and roll with two controls."""

    states = ("v", "p")
    inputs = ("lat", "ped")
    outputs = ("v", "p")
    Lp, Lv, Yv, Llat, Lped = (
        gb.Parameter(0.5 * value, bounds=(-40, 40)) for value in TRUTH.values()
    )

    def derivative(self, x, u, p):
        return (
            p.Yv * x.v + 2 * x.p + u.ped,
            p.Lv * x.v + p.Lp * x.p + p.Llat * u.lat + p.Lped * u.ped,
        )

    def output(self, x, u, p):
        return x.v, x.p


def matrix():
    """Return the four responses at the truth, by numpy alone."""
    A = np.array([[TRUTH["Yv"], 2.0], [TRUTH["Lv"], TRUTH["Lp"]]])
    B = np.array([[0.0, 1.0], [TRUTH["Llat"], TRUTH["Lped"]]])
    G = np.linalg.solve(1j * OMEGA[:, None, None] * np.eye(2) - A, np.broadcast_to(B, (8, 2, 2)))
    return [
        [
            gb.FrequencyResponse(OMEGA, G[:, k, i], input=u, output=y)
            for i, u in enumerate(Roll.inputs)
        ]
        for k, y in enumerate(Roll.outputs)
    ]


def test_every_form_of_a_matrix_makes_the_same_sum(tmp_path):
    rows = matrix()
    flat = [r for row in rows for r in row]
    gb.data.write_responses(flat, tmp_path / "matrix.csv")
    named = {f"{r.output}/{r.input}": r for r in flat}
    by_pair = {(r.output, r.input): r for r in flat}
    for form in (rows, flat, named, by_pair, np.array(rows, dtype=object),
                 gb.data.read_responses(tmp_path / "matrix.csv")):  # fmt: skip
        problem = gb.several(Roll(), form)
        assert [part.name for part in problem.parts] == ["v/lat", "v/ped", "p/lat", "p/ped"]
        assert_allclose([p.response.response for p in problem.parts], [r.response for r in flat])

    fit = gb.fit(problem, starts=2, progress=False)
    assert_allclose([fit.estimate[name] for name in TRUTH], list(TRUTH.values()), rtol=1e-6)
    assert [part.name for part in fit.responses] == list(named)


def test_weights_and_bands_go_to_their_pairs():
    rows = [[matrix()[0][0], None], matrix()[1]]
    problem = gb.several(Roll(), rows, weight={"p/lat": 2.0}, band={"p/ped": (1.0, 10.0)})
    assert {part.name: part.weight for part in problem.parts} == {
        "v/lat": 1.0, "p/lat": 2.0, "p/ped": 1.0,
    }  # fmt: skip
    v, lat, ped = (part.response.omega for part in problem.parts)
    assert len(v) == len(lat) == 8
    assert_allclose(ped, OMEGA[(OMEGA >= 1) & (OMEGA <= 10)])
    with pytest.raises(ValueError, match="no pair 'p/pedal'"):
        gb.several(Roll(), rows, weight={"p/pedal": 2.0})


def test_a_band_of_a_single_response_is_refused_with_what_cuts_it():
    with pytest.raises(TypeError, match=r"band is for several responses: .*\.between\(low, high\)"):
        gb.several(Roll(), matrix()[0][0], band={"v/lat": (1.0, 10.0)})


def test_responses_of_one_name_are_numbered_once_however_they_are_added():
    (first, other), _ = matrix()
    again = gb.FrequencyResponse(1.1 * OMEGA, first.response, input="lat", output="v")
    names = ["v/lat 1", "v/ped", "v/lat 2"]
    together = gb.several(Roll(), [first, other, again])
    one_by_one = sum(gb.Problem(Roll(), response) for response in (first, other, again))
    for problem in (together, one_by_one):
        assert [part.name for part in problem.parts] == names
    assert [part.name for part in (one_by_one + together).parts][-1] == "v/lat 4"
    fit = gb.fit(together, starts=1, progress=False)
    assert all(f"({name})" in str(fit) for name in names)


def test_an_frd_of_python_control_is_a_matrix():
    control = pytest.importorskip("control")
    values = np.array([[r.response for r in row] for row in matrix()])
    system = control.frd(values, OMEGA, inputs=["lat", "ped"], outputs=["v", "p"])
    problem = gb.several(Roll(), gb.interop.from_control(system))
    assert_allclose([p.response.response for p in problem.parts], values.reshape(4, 8))


def test_names_with_underscores_need_their_pairs(tmp_path):
    path = tmp_path / "matrix.csv"
    r = matrix()[0][0]
    pair = gb.FrequencyResponse(OMEGA, r.response, input="stick_x", output="rate")
    gb.data.write_responses([pair], path)
    [back] = gb.data.read_responses(path)
    assert (back.input, back.output) == ("stick_x", "rate")
    path.write_text(path.read_text().split("\n", 1)[1])
    with pytest.raises(ValueError, match="state the pairs"):
        gb.data.read_responses(path)


@pytest.mark.parametrize("form", ["list", "rows", "array", "by pair"])
def test_a_problem_of_several_responses_is_refused_and_the_function_named(form):
    rows = matrix()
    flat = [r for row in rows for r in row]
    data = {
        "list": flat,
        "rows": rows,
        "array": np.array(rows, dtype=object),
        "by pair": {r.pair: r for r in flat},
    }[form]
    with pytest.raises(TypeError, match=r"gb\.several\(model, ") as caught:
        gb.Problem(Roll(), data)
    assert "\n" not in str(caught.value)
    assert len(gb.several(Roll(), data).parts) == 4


def test_parameters_of_each_response_have_its_number():
    lat, ped = matrix()[1]
    both = gb.several(Roll(), [lat, ped], own=["Lp"])
    assert {"Lp_1", "Lp_2", "Lv"} < {*both.parameters}


def test_a_mapping_by_anything_but_pairs_names_its_keys():
    with pytest.raises(TypeError, match=r"keys 'roll': give every FrequencyResponse by its pair"):
        gb.several(Roll(), {"roll": matrix()[0][0]})


def test_the_cost_of_every_pair_is_that_of_cifer_and_stands_in_the_details():
    # 10 % more gain at every point of one pair: 0.828 dB, no phase.
    rows = matrix()
    rows[1][0] = gb.FrequencyResponse(OMEGA, 1.1 * rows[1][0].response, input="lat", output="p")
    fixed = {name: value for name, value in TRUTH.items() if name != "Lped"}
    fit = gb.fit(gb.several(Roll(), rows, fixed=fixed), starts=1, progress=False)
    weight = 1.58 * (1 - np.exp(-1))
    expected = 20 * weight**2 * (20 * np.log10(1.1)) ** 2
    costs = {part.name: part.magnitude_phase_cost for part in fit.responses}
    assert_allclose(costs["p/lat"], expected, rtol=1e-6)
    assert costs["v/lat"] < 1e-6
    assert "3.42 on average" in fit.details
    assert "p/lat 13.7" in fit.details
    by_part = {row["part"]: row["magnitude_phase_cost"] for row in fit.to_dict()["responses"]}
    assert by_part == costs


def test_a_response_that_the_model_lacks_is_not_explained():
    # Without Lped and Lv, the pedals do not reach p.
    names = {"Lped": 0.0, "Lv": 0.0}
    fit = gb.fit(gb.several(Roll(), matrix(), fixed=names), starts=1, progress=False)
    assert not np.any(fit.responses[3].response)
    assert "does not explain the data" in str(fit)
    assert "a response of p to ped" in str(fit)
