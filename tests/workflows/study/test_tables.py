"""Estimates of a study as rows, as LaTeX, and by factors: the numbers are those of the fits."""

import csv
import io
import re
import warnings
from dataclasses import replace

import pytest
from small_study import Broken, data

import greybox as gb
from greybox.workflows.study.latex import latex_number, latex_symbol, latex_text
from greybox.workflows.study.members import StudyMember
from greybox.workflows.study.study import Study, progress


def test_every_member_and_parameter_has_a_row(small_study):
    frame = small_study.to_pandas()
    assert len(frame) == 3 * (2 + 1 + 3) + 2 + 1
    row = frame[(frame.member == "fast, Lag") & (frame.parameter == "T_lag")].iloc[0]
    fit = small_study["fast, Lag"].fit
    assert (row.value, row.standard_error) == (fit.estimate["T_lag"], fit.standard_error["T_lag"])
    assert (row.low, row.high) == fit.interval()["T_lag"]
    assert (row.model, row.data, row.unit, row.cost) == ("Lag", "fast", "s", fit.cost)
    wide = frame[frame.model == "Lag"].pivot_table(
        index="data", columns="parameter", values="value"
    )
    assert wide.loc["hover", "T_lag"] == pytest.approx(0.2, rel=0.05)
    rows = list(csv.DictReader(io.StringIO(small_study.to_csv())))
    assert [row["member"] for row in rows] == frame.member.tolist()
    assert float(rows[0]["value"]) == frame.value[0]


def test_members_are_selected_and_grouped_by_factors(small_study):
    assert [m.name for m in small_study.select(model="Lag", seed=1).members] == ["fast again"]
    two = small_study.select(model=["Lag", "Gain"], data="slow")
    assert [m.name for m in two.members] == ["slow, Lag", "slow, Gain"]
    groups = small_study.groups("data")
    assert {name: len(group.members) for name, group in groups.items()} == {
        "hover": 3,
        "slow": 4,
        "fast": 4,
    }
    with pytest.raises(ValueError, match=r"factor 'modell'.*did you mean 'model'"):
        small_study.select(modell="Lag")
    with pytest.raises(ValueError, match=r"no member whose model is 'Lg'; it has .*'Lag'"):
        small_study.select(model="Lg")
    assert not small_study.select(status="unfinished").members


def test_a_table_of_latex_has_rows_by_data_and_values_with_errors(small_study):
    text = small_study.select(model="Lag", seed=0).to_latex()
    lines = [line.removesuffix(r" \\") for line in text.splitlines() if "&" in line]
    assert lines[0].split(" & ") == ["data", "$K$", r"$T_{\mathrm{lag}}$ (s)"]
    fit = small_study["slow, Lag"].fit
    name, gain, lag = lines[2].split(" & ")
    assert name == "slow"
    for cell, parameter in ((gain, "K"), (lag, "T_lag")):
        value, error = map(float, re.findall(r"[\d.]+", cell))
        assert value == pytest.approx(fit.estimate[parameter], abs=fit.standard_error[parameter])
        assert error == pytest.approx(fit.standard_error[parameter], rel=0.05)
    # Structures with other parameters have tables of their own, with rows that are told apart.
    whole = small_study.to_latex()
    assert whole.count(r"\toprule") == 3
    assert "data & seed &" in whole


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (4.2567, 0.12, r"$4.26 \pm 0.12$"),
        (12.4, 340.0, r"$12 \pm 340$"),
        (3.456e-9, None, r"$3.456 \cdot 10^{-9}$"),
        (None, None, "--"),
    ],
)
def test_numbers_in_latex(value, error, shown):
    assert latex_number(value, error) == shown


def test_names_in_latex():
    assert latex_symbol("omega_p", "rad/s") == r"$\omega_{\mathrm{p}}$ (rad/s)"
    assert latex_symbol("M_theta") == r"$M_{\theta}$"
    assert latex_symbol("lambda_dot", "1/s") == r"$\dot{\lambda}$ (1/s)"
    assert latex_symbol("Tau_n") == r"$\mathrm{Tau}_{\mathrm{n}}$"  # LaTeX has no \Tau
    assert latex_symbol("_") == r"$\_$"
    assert latex_symbol("M_θ") == r"$M_{\mathrm{θ}}$"
    assert latex_symbol("a3_tilde") == r"$\tilde{a}_{\mathrm{3}}$"
    assert latex_symbol("damping", "kg m/s^2") == r"$\mathrm{damping}$ (kg m/s$^{2}$)"
    assert latex_text("50 % of a_1 & {b}") == r"50 \% of a\_1 \& \{b\}"


def test_a_failed_member_has_no_fit_but_a_reason_with_the_cure(small_study):
    broken = small_study["broken"]
    assert broken.fit is None
    assert "divides by zero" in broken.reason
    assert broken.factors["model"] == "Broken"
    assert "1  broken" in small_study.failures
    assert small_study.select(status="done").failures == ""


def test_a_model_that_is_not_finite_makes_no_warnings_of_numpy():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = gb.fit(gb.Problem(Broken(), data("slow")), starts=1, progress=False)
    assert not fit.converged


def test_the_progress_of_a_study_has_the_time_left_and_what_failed(small_study, monkeypatch):
    def member(number, **answer):
        return StudyMember(small_study.folder, number, f"m{number}", answer, 0)

    # An hour passed between the third and the fourth member.
    done = [
        replace(m, answer={**m.answer, "finished": 10.0 * k - 3600 * (k < 4)})
        for k, m in enumerate(small_study.done, 1)
    ]
    broken = replace(small_study["broken"], answer={"error": small_study["broken"].error})
    study = Study(small_study.folder, (*done, broken, *map(member, range(12))))
    monkeypatch.setattr("time.time", lambda: 130.0)
    text = progress(study)
    assert "23 members: 10 done, 1 failed, 12 unfinished" in text
    # Ten members at 10 s each, of which the last one ended at 100 s; twelve are left.
    assert "about 2 min left, at 10 s a member; the last one ended 30 s ago" in text
    assert "divides by zero" in text
    assert "min left" not in progress(small_study)  # nothing is left
