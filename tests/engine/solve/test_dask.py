"""Runs on a real Dask scheduler with workers of its own, all of them processes on this machine."""

import subprocess
import sys
from contextlib import contextmanager
from importlib import import_module

import pytest
from command_line import QUICK, refused, run
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from numpy.testing import assert_array_equal

import greybox as gb
from greybox.workflows.study.stored_runs import StoredRuns

RESPONSE = gb.Problem(
    LagLagDelay(), measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=2)
)


@pytest.fixture
def distributed():
    """The package, whose import takes half a second: not where tests are only collected."""
    return pytest.importorskip("distributed", reason="needs the extra dask")


@contextmanager
def processes(*commands, folder):
    """Run these commands of Dask, their messages in files."""
    started = []
    try:
        for k, command in enumerate(commands):
            with (folder / f"{k}.log").open("w") as log:
                words = [sys.executable, "-m", "dask", *command.split()]
                started.append(subprocess.Popen(words, cwd=folder, stdout=log, stderr=log))
        yield started
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.wait()


WORKER = "worker --scheduler-file scheduler.json --nthreads 1 --no-dashboard --no-nanny"


@pytest.mark.filterwarnings("ignore")  # of a package that is not ours
def test_the_answer_of_a_cluster_and_what_becomes_of_it_when_parts_are_lost(
    tmp_path, capsys, monkeypatch, distributed
):
    scheduler = "scheduler --host 127.0.0.1 --port 0 --no-dashboard --scheduler-file scheduler.json"
    with (
        processes(scheduler, WORKER, WORKER, folder=tmp_path) as (head, first, _),
        distributed.Client(scheduler_file=str(tmp_path / "scheduler.json"), timeout=120) as client,
    ):
        client.wait_for_workers(2, timeout=120)
        alone = gb.fit(RESPONSE, 16, search="multistart")
        together = gb.fit(RESPONSE, 16, search="multistart", executor=client.get_executor())
        assert together.estimate == alone.estimate
        for one, other in zip(alone.runs, together.runs, strict=True):
            assert_array_equal(one.estimate, other.estimate)

        status, out, _ = run(
            capsys,
            "fit",
            "rotors",
            *QUICK,
            "--scheduler",
            client.scheduler_info()["address"],
            "--json",
        )
        assert status == 0
        assert '"starts": 8' in out

        # A worker is lost.
        fewer = gb.fit(
            RESPONSE,
            24,
            search="multistart",
            executor=client.get_executor(),
            progress=lambda done, _: first.kill(),
        )
        assert len(fewer.runs) == 24
        assert all(
            one.status == other.status for one, other in zip(alone.runs, fewer.runs, strict=False)
        )

        # The scheduler is lost in mid-study: that is said, and the study goes on without it.
        made = []
        add = StoredRuns.add

        def noted(self, number, start, outcome):
            add(self, number, start, outcome)
            if type(self) is not StoredRuns:  # of the whole member, which took too long
                return
            made.append(number)
            if len(made) == 10:
                head.kill()

        monkeypatch.setattr(StoredRuns, "add", noted)
        # A small member would be fitted as a whole: its workers share the runs of a large one.
        monkeypatch.setattr(import_module("greybox.workflows.study.batch"), "UNWRITTEN", 1e-9)
        member = gb.study.Member(RESPONSE, 40, name="response", search="multistart")
        with pytest.raises(
            RuntimeError,
            match="the executor gave up its tasks: its workers or its scheduler are gone",
        ):
            gb.batch([member], tmp_path / "study", executor=client.get_executor(), progress=False)
        assert gb.study.read_study(tmp_path / "study")["response"].status == "unfinished"
        kept = len(made)
        assert 10 <= kept < 40
    study = gb.batch([member], tmp_path / "study", progress=False)
    assert sorted(made) == list(range(40))  # none twice
    for one, other in zip(alone.runs, study["response"].fit.runs, strict=False):
        assert_array_equal(one.estimate, other.estimate)


@pytest.mark.usefixtures("distributed")
@pytest.mark.filterwarnings("ignore")
def test_a_scheduler_that_is_not_there(capsys, monkeypatch):
    monkeypatch.setattr("greybox.cli.workers.CONNECTING", 0.2)
    said = refused(capsys, "fit", "rotors", *QUICK, "--scheduler", "127.0.0.1:9")
    assert "no Dask scheduler answers at '127.0.0.1:9'" in said
