"""Fits in pickles: in this process, in a spawned one, and what cannot be pickled."""

import copy
import pickle
from multiprocessing import get_context

import numpy as np
import pytest
from hardening_spring import Spring, driven

import greybox as gb

RESPONSE = gb.FrequencyResponse(
    OMEGA := np.geomspace(0.5, 10, 20),
    1 / (4 - OMEGA**2 + 0.5j * OMEGA) * (1 + 0.01 * np.exp(1j * 7 * OMEGA**1.3)),
    "force",
    "position",
)


@pytest.fixture(scope="module", params=["record", "response"])
def fit(request):
    data = driven(noise=0.01) if request.param == "record" else RESPONSE
    return gb.fit(gb.Problem(Spring(), data), starts=2, progress=False)


@pytest.fixture(scope="module")
def spawned():
    """Another process, which imports what a pickle names."""
    with get_context("spawn").Pool(1) as pool:
        yield pool


def use(pickled, record, path):
    """Use a fit from a pickle: print, simulate, compare and save it."""
    fit = pickle.loads(pickled)
    gb.save(fit, path)
    motion = gb.simulate(fit, record=record)
    return (
        str(fit),
        dict(fit.estimate),
        motion["position"],
        str(gb.compare(fit, gb.load(path, models=[Spring]))),
    )


def test_a_fit_from_a_pickle_is_the_same_in_this_process_and_in_a_spawned_one(
    fit, spawned, tmp_path
):
    record, pickled = driven(), pickle.dumps(fit)
    motion = gb.simulate(fit, record=record)["position"]
    here = use(pickled, record, tmp_path / "here.h5")
    there = spawned.apply(use, (pickled, record, tmp_path / "there.h5"))

    for text, estimate, x, compared in (here, there):
        assert text == str(fit)
        assert estimate == dict(fit.estimate)
        assert np.array_equal(x, motion)
        assert compared == here[3]


def test_a_fit_whose_class_cannot_be_imported_is_refused_in_a_sentence_and_can_be_copied(fit):
    class Local(Spring):
        pass

    problem = gb.Problem(Local(), fit.parts[0].data)
    local = gb.fit(problem, starts=1, progress=False)
    with pytest.raises(TypeError, match=r"Local of the module .*gb\.save\(fit, path\)"):
        pickle.dumps(local)
    assert str(copy.deepcopy(local)) == str(local)
    assert type(copy.copy(problem.model)) is Local
