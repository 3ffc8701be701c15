"""Results in HDF5: everything comes back, damage is told in a sentence, a failing write leaves the old file."""

import dataclasses
import importlib
import json
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pytest
from crafted_results import change_fit, model, numbers, rewritten, stated, values
from declared_models import (
    ROTOR,
    ROTOR_OMEGA,
    TILT,
    TILT_OMEGA,
    TWO_LAGS_OMEGA,
    Integrator,
    Lag,
    measured,
)
from hardening_spring import Spring, driven
from numpy.testing import assert_array_equal, assert_equal

import greybox as gb
from greybox.assessment.fitted_part import FittedPart, FittedRecord
from greybox.assessment.storage import to_bytes
from greybox.assessment.stored_values import read, write
from greybox.data.files.sealed_files import write_sealed
from greybox.models.polynomial import Polynomial
from greybox.models.rotor import Rotor
from greybox.models.tilt import LinearTilt, Tilt
from greybox.problems import pitch_hover

SHARED = TILT | {n: ROTOR[n] for n in ("T_rotor", "T_delay")}
NOISY = measured(
    Tilt(),
    TILT_OMEGA,
    SHARED,
    noise=0.02,
    columns={"coherence": np.full(16, 0.9), "dof": np.full(16, 8)},
)
SPEED = measured(Rotor(), ROTOR_OMEGA, ROTOR, noise=0.02, name="speed")
LAG_PROBLEM = gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA, {"K": 2.0}, noise=0.02))
LAG = gb.fit(LAG_PROBLEM, starts=6)


def swinging(part):
    return measured(part, np.geomspace(1, 30, 12), noise=0.02, seed=9)


def problems():
    series, polynomial = Rotor() * Integrator(), Polynomial(4, 1)
    return {
        "plain": LAG_PROBLEM,
        "renamed sum": gb.Problem(
            Tilt(),
            NOISY,
            gb.MagnitudePhase(),
            free=("T_rotor", "T_delay"),
            tied={"a2": lambda p: p.a4 / 50},
            rename={"T_rotor": "T_m"},
        )
        + gb.Problem(
            Rotor(),
            SPEED,
            gb.MagnitudePhase(),
            rename={"T_rotor": "T_m"},
            weight=2.0,
            delay="pade:2",
        ),
        "ode": gb.Problem(
            LinearTilt(),
            NOISY,
            constraints=[lambda p: p.a4 - 10],
            at={"theta": 0.0},
            fixed={"T_rotor": 0.05},
        ),
        "series": gb.Problem(series, swinging(series)),
        "polynomial": gb.Problem(polynomial, swinging(polynomial)),
    }


def assert_same(a, b):
    """Every field that a loaded answer has, bit by bit."""
    assert str(a) == str(b)
    for mine, other in zip(a.quantities, b.quantities, strict=True):
        assert_array_equal(
            [mine.value, mine.standard_error, *mine.bounds, *mine.box],
            [other.value, other.standard_error, *other.bounds, *other.box],
        )
        words = [(q.name, q.kind, q.unit, q.about, q.at_bound) for q in (mine, other)]
        assert words[0] == words[1]
    for name in (
        "name",
        "free",
        "names",
        "warnings",
        "seed",
        "starts",
        "versions",
        "checksum",
        "status",
    ):
        assert repr(getattr(a, name)) == repr(getattr(b, name)), name
    assert_array_equal(a.covariance, b.covariance)
    assert_array_equal(
        [a.cost, a.dof, a.seconds, *a.costs.values()], [b.cost, b.dof, b.seconds, *b.costs.values()]
    )
    assert len(a.runs) == len(b.runs)
    for mine, other in [*zip(a.runs, b.runs, strict=True), *zip(a.minima, b.minima, strict=True)]:
        assert type(mine) is type(other)
        for field in dataclasses.fields(mine):
            assert_array_equal(getattr(mine, field.name), getattr(other, field.name))
    for mine, other in zip(a.parts, b.parts, strict=True):
        for field in (
            "name",
            "criterion",
            "criterion_class",
            "settings",
            "is_likelihood",
            "rule",
            "delay",
            "weight",
            "constraints",
            "pade_error",
            "label",
            "equation",
        ):
            assert getattr(mine, field) == getattr(other, field), field
        for field in ("at", "rename", "tied", "model"):
            assert json.loads(json.dumps(dict(getattr(mine, field)))) == dict(getattr(other, field))
        assert_array_equal(mine.response, other.response)
        assert mine.data.checksum == other.data.checksum
        assert (mine.data.name, mine.data.source) == (other.data.name, other.data.source)
        assert mine.curve.checksum == other.curve.checksum
    assert a.interval() == b.interval() or np.isnan(list(a.interval().values())).any()


@pytest.mark.parametrize("name", problems())
def test_everything_comes_back(name, tmp_path):
    fit = gb.fit(problems()[name], starts=2, profiles=False)
    gb.save(fit, tmp_path / "a.h5")
    loaded = gb.load(tmp_path / "a.h5", models=[Lag, Integrator])
    assert_same(fit, loaded)
    gb.save(loaded, tmp_path / "b.h5")
    assert_same(fit, gb.load(tmp_path / "b.h5"))
    for k in range(len(fit.parts)):
        omega = np.geomspace(1, 20, 5)
        assert_array_equal(
            fit.response(omega, part=k).response, loaded.response(omega, part=k).response
        )
    assert loaded.covariance_of(fit.free[:2]).tolist() == fit.covariance_of(fit.free[:2]).tolist()


HOLES = driven(6.0, noise=0.02, seed=5)
HOLES = HOLES.with_signals(position=np.where(np.arange(300) % 7 == 3, np.nan, HOLES["position"]))
RECORDS = {
    "record": gb.Problem(Spring(), HOLES, gb.OutputError(biases=("position",))),
    "renamed": gb.Problem(
        Spring(),
        HOLES,
        gb.OutputError(noise={"position": 0.02}, inputs="held"),
        rename={"stiffness": "k"},
    ),
    "record and response": gb.Problem(Spring(), HOLES)
    + gb.Problem(Spring(), measured(Spring(), np.geomspace(0.5, 8, 12), noise=0.02)),
}


@cache
def fitted(name):
    return gb.fit(RECORDS[name], starts=2, profiles=False)


def test_errors_that_are_correlated_along_frequency_come_back(tmp_path):
    data = dataclasses.replace(pitch_hover.data(), about={})
    fit = gb.fit(gb.Problem(pitch_hover.problem().model, data), starts=5)
    gb.save(fit, tmp_path / "a.h5")
    loaded = gb.load(tmp_path / "a.h5")
    assert_array_equal(fit.independent[0], loaded.independent[0])
    assert fit.independent[1] == loaded.independent[1] > fit.dof == loaded.dof


@pytest.mark.parametrize("name", RECORDS)
def test_a_fitted_record_comes_back(name, tmp_path):
    fit = fitted(name)
    gb.save(fit, tmp_path / "a.h5")
    loaded = gb.load(tmp_path / "a.h5", models=[Spring])
    assert str(fit) == str(loaded)
    assert_array_equal(fit.white, loaded.white)
    for mine, other in zip(fit.records, loaded.records, strict=True):
        for f in {field.name for field in dataclasses.fields(mine)} - {
            "data",
            "simulated",
            "initial",
            "model",
        }:
            assert_equal(getattr(mine, f), getattr(other, f), err_msg=f)
        assert list(mine.initial) == list(other.initial)
        assert_array_equal([*mine.initial.values()], [*other.initial.values()])
        for a, b in ((mine.data, other.data), (mine.simulated, other.simulated)):
            assert (a.name, a.source, a.checksum, a.units) == (
                b.name,
                b.source,
                b.checksum,
                b.units,
            )
            assert list(a.signals) == list(b.signals)
            assert_array_equal(a.time, b.time)
            assert_array_equal([*a.signals.values()], [*b.signals.values()])
    a, b = gb.predict(fit), gb.predict(loaded)
    assert_array_equal(a.predicted, b.predicted)
    gb.save(loaded, tmp_path / "b.h5")
    assert str(gb.load(tmp_path / "b.h5")) == str(fit)


def test_which_gains_a_record_was_fitted_with_comes_back(tmp_path):
    fit = fitted("record")
    part = dataclasses.replace(fit.parts[0], gains=(("velocity", "position"),))
    gb.save(dataclasses.replace(fit, parts=(part,)), tmp_path / "a.h5")
    assert gb.load(tmp_path / "a.h5").parts[0].gains == (("velocity", "position"),)


def test_names_units_and_holds_of_a_record_come_back():
    record = gb.Record(
        np.cumsum([0.1, 0.2, 0.1]),
        {"b/c%2F": np.array([1.0, np.nan, 3.0]), "a": np.ones(3)},
        {"a": "m/s"},
        "r",
        "log.bin",
        hold={"a": np.inf},
        findings=("a gap",),
    )
    back = read(json.loads(json.dumps(write(record))), gb.Record)
    assert list(back.signals) == ["b/c%2F", "a"]
    assert_array_equal(back["b/c%2F"], record["b/c%2F"])
    assert (back.units, back.hold, back.findings) == ({"a": "m/s"}, {"a": np.inf}, ())
    assert (back.name, back.source, back.checksum) == ("r", "log.bin", record.checksum)


def test_a_failed_fit_comes_back(tmp_path):
    fit = gb.fit(LAG_PROBLEM, starts=3, solver_options={"max_iter": 1})
    gb.save(fit, tmp_path / "a.h5")
    loaded = gb.load(tmp_path / "a.h5")
    assert str(loaded) == str(fit)
    assert not loaded.converged
    assert loaded.status == fit.status
    assert [run.status for run in loaded.runs] == [run.status for run in fit.runs]
    for one in (fit, loaded):
        with pytest.raises(ValueError, match="has no estimate"):
            one.correlation  # noqa: B018


def test_an_earlier_fit_from_a_file_is_taken_as_fixed_values(tmp_path):
    rotor = gb.fit(gb.Problem(Rotor(), SPEED), starts=2)
    gb.save(rotor, tmp_path / "rotor.h5")
    a, b = (
        gb.fit(gb.Problem(Tilt(), NOISY, fixed=f), starts=2)
        for f in (rotor, gb.load(tmp_path / "rotor.h5"))
    )
    assert a.standard_error == b.standard_error


def test_numbers_of_numpy_in_the_operating_point_are_stored(tmp_path):
    for zero in (np.float32(0), np.int64(0)):
        fit = gb.fit(gb.Problem(LinearTilt(), NOISY, at={"theta": zero}), [{}], profiles=False)
        gb.save(fit, tmp_path / "a.h5")
        assert gb.load(tmp_path / "a.h5").parts[0].at == {"theta": 0.0}


def test_any_hdf5_reader_understands_the_file(tmp_path):
    gb.save(LAG, tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        _, _, fit = json.loads(file["fit"][()])
    values = {q["name"]: q["value"] for q in fit["quantities"]}
    assert values["T"] == LAG.estimate["T"]
    assert_array_equal(fit["covariance"]["numbers"], LAG.covariance.ravel())
    assert_array_equal(fit["parts"][0]["data"]["omega"]["numbers"], TWO_LAGS_OMEGA)


def test_a_failing_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.h5"
    gb.save(LAG, path)
    before = path.read_bytes()
    with pytest.raises(TypeError):
        gb.save(dataclasses.replace(LAG, starts=object()), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_a_good_write_replaces_the_old_file_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "a.h5"
    path.write_text("old")
    gb.save(LAG, str(path))
    assert str(gb.load(str(path))) == str(LAG)
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def edited(tmp_path, change):
    path = tmp_path / "a.h5"
    gb.save(LAG, path)
    change_fit(path, path, change)
    return path


def test_a_file_that_was_changed_is_refused(tmp_path):
    path = tmp_path / "a.h5"
    gb.save(LAG, path)
    with h5py.File(path, "a") as file:
        file["fit"][()] = file["fit"][()].replace(b"1", b"2")
    with pytest.raises(ValueError, match="is damaged or was changed since it was saved") as caught:
        gb.load(path)
    assert str(path) in str(caught.value)


def shifted(stored):
    stored[2]["parts"][0]["data"]["response"]["numbers"][0] += 1e-12


def forget(name):
    return lambda stored: stored[2].__delitem__(name)


def response(**array):
    return numbers("parts", 0, "data", "response", **array)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            stated(layout=99),
            "has layout 99 .* install a newer",
        ),
        (stated(layout=3), "has layout 3 .* fit again"),
        (stated(layout="x"), "damaged"),
        (stated(checksum="x"), "its data do not match their checksum"),
        (rewritten("[9, 1]"), "not a greybox fit or is damaged"),
        (rewritten("{"), "damaged"),
        (values(versions="{"), "damaged"),
        (forget("runs"), "damaged"),
        (forget("parts"), "damaged"),
        (forget("covariance"), "damaged"),
        (values(quantities=[{}]), "damaged"),
        (shifted, "its data do not match their checksum"),
        (values(warnings=[0.0, 0.0]), "damaged"),
        (numbers("runs", "cost", shape=[1], numbers=[0.0]), "damaged"),
        (numbers("covariance", shape=[1], numbers=[0.0]), "covariance has another shape"),
        (numbers("covariance", shape=[2, 2], numbers=[0.0]), "damaged"),
        (response(shape=[2, 30], numbers=[float("nan")] * 60), "damaged"),
        (response(shape=[2, 3], numbers=[0.0] * 6), "damaged"),
        (values(name="x" * 10**6), "a text has more than 100000 characters"),
    ],
)
def test_a_file_that_is_no_result_is_refused_in_a_sentence(tmp_path, change, words):
    path = edited(tmp_path, change)
    with pytest.raises(ValueError, match=words) as caught:
        gb.load(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("kept", [0, 100, 0.9])
def test_a_truncated_file_is_refused(tmp_path, kept):
    path = tmp_path / "a.h5"
    gb.save(LAG, path)
    raw = path.read_bytes()
    path.write_bytes(raw[: kept if isinstance(kept, int) else int(kept * len(raw))])
    with pytest.raises(ValueError, match=r"not a greybox fit|is damaged"):
        gb.load(path)


def test_what_is_no_hdf5_file_is_refused(tmp_path):
    text = tmp_path / "a.h5"
    text.write_text("omega,alpha\n1,2\n")
    with pytest.raises(ValueError, match="not a greybox fit: give a file that"):
        gb.load(text)
    with pytest.raises(TypeError, match=r"^fit is 'a fit': give what gb\.fit or gb\.load returns"):
        gb.save("a fit", tmp_path / "none.h5")
    with pytest.raises(FileNotFoundError, match="there is no file"):
        gb.load(tmp_path / "none.h5")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        gb.load(tmp_path)
    with pytest.raises(OSError, match=r"no\.h5"):
        gb.save(LAG, tmp_path / "no_folder" / "no.h5")


OVERWRITE = """
import os, signal, sys
import numpy as np
import greybox as gb
path, raw = sys.argv[1], open(sys.argv[1], "rb").read()
gb.load(path)
random = np.random.default_rng(1)
bad = []
for k in range(60):
    start = int(random.integers(len(raw)))
    noise = random.integers(0, 256, int(random.integers(1, 64)), dtype=np.uint8).tobytes()
    open(path, "wb").write((raw[:start] + noise + raw[start + len(noise):])[:len(raw)])
    child = os.fork()
    if child == 0:
        signal.alarm(3)
        try:
            gb.load(path)
        except ValueError as error:
            os._exit(0 if path in str(error) else 1)
        except BaseException:
            os._exit(1)
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    if status:
        bad.append((start, "hangs" if os.WIFSIGNALED(status) else "no sentence"))
print(bad)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_overwritten_bytes_end_in_a_sentence_and_never_in_a_hang(tmp_path):
    """Every load has its own process and alarm."""
    still = dataclasses.replace(
        LAG, seconds=1.0, runs=tuple(dataclasses.replace(r, seconds=0.1) for r in LAG.runs)
    )
    gb.save(still, tmp_path / "a.h5")
    done = subprocess.run(
        [sys.executable, "-c", OVERWRITE, str(tmp_path / "a.h5")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[]"


MODEL_FILE = '''
import greybox as gb


class Mine(gb.TransferFunction):
    """A lag of one's own."""

    T = gb.Parameter(0.2, bounds=(0.01, 10), unit="s")

    def response(self, s, p):
        return 1 / (p.T * s + 1)
'''


def test_a_model_is_needed_only_for_its_response_and_only_if_it_is_handed_over(
    tmp_path, monkeypatch
):
    import matplotlib as mpl

    mpl.use("Agg")
    name = "a_model_file_of_ones_own"
    file = tmp_path / f"{name}.py"
    file.write_text(MODEL_FILE)
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module(name)
    model = module.Mine()
    fit = gb.fit(
        gb.Problem(model, measured(model, TWO_LAGS_OMEGA, noise=0.02)), starts=2, profiles=False
    )
    gb.save(fit, tmp_path / "a.h5")

    loaded = gb.load(tmp_path / "a.h5")
    assert str(loaded) == str(fit)
    assert gb.plot(loaded) is not None
    with pytest.raises(
        LookupError, match=f"the model Mine of the module '{name}' is needed and was not found"
    ):
        loaded.response([1.0, 2.0])

    expected = fit.response([1.0, 2.0]).response
    for given in ({module.Mine}, [model], [module], [str(file)], module.Mine, str(file)):
        again = gb.load(tmp_path / "a.h5", models=given)
        assert_array_equal(again.response([1.0, 2.0]).response, expected)
    with pytest.raises(
        LookupError, match=r"Mine .* not found among .* those given \(Tilt, Rotor\)"
    ):
        gb.load(tmp_path / "a.h5", models=[Tilt, Rotor]).response([1.0])
    with pytest.raises(TypeError, match="models is 5: give model classes"):
        gb.load(tmp_path / "a.h5", models=[5])


def test_a_model_of_the_right_name_with_other_parameters_is_refused(tmp_path):
    """The names that differ are said, whichever of the two models has them."""
    gb.save(LAG, tmp_path / "a.h5")
    for names, words in (
        (["K", "tau"], r"\(T, tau\)"),
        (["K"], r"\(T\)"),
        (["K", "T", "c"], r"\(c\)"),
    ):
        declared = {name: gb.Parameter(1.0) for name in names}
        wrong = type("Lag", (gb.TransferFunction,), {"response": lambda self, s, p: p.K} | declared)
        with pytest.raises(ValueError, match=f"Lag and the fitted one differ in .* {words}: give"):
            gb.load(tmp_path / "a.h5", models=[Integrator, wrong])
    assert gb.load(tmp_path / "a.h5", models=[Integrator, Lag]).model_of().label == "Lag"


@pytest.mark.parametrize("name", ["evil_side_effect", "greybox.cli.main"])
def test_nothing_that_a_file_names_is_imported(tmp_path, monkeypatch, name):
    """Not from the working directory, the standard library or greybox, nor what is already loaded."""
    (tmp_path / "evil_side_effect.py").write_text("open('EXECUTED', 'w').close()\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    before = {*sys.modules}
    loaded = gb.load(edited(tmp_path, model(f"{name}:Lag")))
    assert str(loaded) == str(LAG)
    with pytest.raises(LookupError, match="is needed and was not found"):
        loaded.response([1.0])
    assert {*sys.modules} <= before | {"unicodedata"}
    assert not (tmp_path / "EXECUTED").exists()


def test_nothing_in_greybox_pickles_or_evaluates_text():
    folder = Path(gb.__file__).parent
    # What goes to the workers of the user's own executor is pickled, and goes to nobody else; the
    # keys of values are hashes of what nobody reads back.
    pickling = {
        folder / "engine" / "solve" / "worker_payload.py",
        folder / "modeling" / "fingerprint.py",
    }
    for file in {*folder.glob("**/*.py")} - pickling:
        text = file.read_text(encoding="utf-8")
        assert not re.search(
            r"^\s*(import|from)\s+(pickle|dill|cloudpickle|joblib|shelve|marshal)\b", text, re.M
        ), file
        assert not re.search(r"allow_pickle\s*=\s*True|(?<![\w.])eval\(|(?<![\w.])exec\(", text), (
            file
        )


FLOWN = gb.Record(np.arange(6.0), {"u": np.arange(6.0) ** 2 / 9, "y": np.ones(6)})


def flown(**changes):
    """A record as an answer keeps it, beside the response of the fit."""
    simulated = FLOWN.with_signals(y=np.zeros(6))
    given = {
        name: getattr(LAG.parts[0], name)
        for name in (f.name for f in dataclasses.fields(FittedPart))
    }
    given |= {
        "data": FLOWN,
        "simulated": simulated,
        "outputs": ("y",),
        "noise": np.eye(1),
        "initial": {},
        "method": "",
    }
    given |= {"inputs": "held", "biases": (), "gains": (), "driven": (), "nuisances": 1}
    return FittedRecord(**(given | changes))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda fit: {"quantities": (fit.quantities[0],) * 2},
            "two quantities have the same name",
        ),
        (lambda fit: {"covariance": fit.covariance[1:]}, "covariance has another shape"),
        (lambda fit: {"parts": ()}, "damaged"),
        (lambda fit: {"runs": fit.runs[fit.runs.cost < 0]}, "it has no data or no runs"),
        (
            lambda fit: part(fit, response=np.zeros(2, complex)),
            "shape",
        ),
        (lambda fit: {"parts": (flown(outputs=("z",)),)}, "an output is not in the data"),
        (
            lambda fit: {"parts": (flown(inputs="guessed"),)},
            "'guessed' is none of",
        ),
        (
            lambda fit: {
                "parts": (flown(simulated=gb.Record(np.arange(6.0) + 1, {"y": np.ones(6)})),)
            },
            "the simulated record and its data have different times",
        ),
        (
            lambda fit: {
                "parts": (flown(simulated=gb.Record(np.arange(6.0), {"u": np.arange(6.0)})),)
            },
            "an output is not in the data",
        ),
        (lambda fit: {"parts": (flown(),)}, ""),
    ],
)
def test_what_does_not_fit_together_is_refused(tmp_path, change, said):
    gb.save(dataclasses.replace(LAG, **change(LAG)), tmp_path / "a.h5")
    if said:
        with pytest.raises(ValueError, match=said):
            gb.load(tmp_path / "a.h5")
    else:
        assert gb.load(tmp_path / "a.h5").free == LAG.free


def test_a_fit_to_a_sine_of_finite_amplitude_is_refused_and_all_others_of_its_time_are_read(
    tmp_path,
):
    path = tmp_path / "a.h5"
    layout, checksum, values = json.loads(to_bytes(LAG))
    values["parts"][0]["sine"] = None
    write_sealed(path, json.dumps([layout, checksum, values]).encode())
    assert gb.load(path).estimate == LAG.estimate

    values["parts"][0]["sine"] = {"signal": "u", "amplitude": 1.0, "harmonics": 3}
    write_sealed(path, json.dumps([layout, checksum, values]).encode())
    with pytest.raises(
        ValueError, match=r"finite amplitude, .*: fit the record in the time domain"
    ):
        gb.load(path)


def part(fit, **changes):
    return {"parts": (dataclasses.replace(fit.parts[0], **changes),)}
