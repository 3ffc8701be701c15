"""Interrupt a batch by Ctrl-C and by SIGTERM at random moments, and see what becomes of it.

``python benchmarks/interrupt_study.py --moments 40 --out benchmarks/results/interrupt_study.txt``
runs batches of every kind of member (responses, records, sums of both, manoeuvres, many responses
of one model) in this process, on worker processes of greybox and of Python, and sends each of them
one of the two signals at a random moment of its time. What must be seen is a KeyboardInterrupt with
the study in its attribute, no failed member, and, from the same call again, the answer of a batch
that was never interrupted, to the last bit. A fit alone is interrupted likewise.
"""

import argparse
import itertools
import json
import math
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.models.tilt import LinearTilt
from greybox.problems import pitch_5deg, pitch_hover, roll_hover

SIGNALS = signal.SIGINT, signal.SIGTERM
EXECUTORS = {
    "this process": nullcontext,
    "WorkerPool": lambda: gb.solve.WorkerPool(2),
    "ProcessPoolExecutor": lambda: ProcessPoolExecutor(2, get_context("spawn")),
}


class Lag(gb.StateSpace):
    """A first-order lag."""

    states, inputs, outputs = ("y",), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(0.1, 10))
    tau = gb.Parameter(0.5, bounds=(0.05, 5))

    def derivative(self, x, u, p):
        """Return the derivative."""
        return ((p.K * u.u - x.y) / p.tau,)

    def output(self, x, u, p):
        """Return the output."""
        return (x.y,)


class Coupled(gb.StateSpace):
    """Roll and pitch of a helicopter in hover, which are coupled."""

    states = ("v", "u", "p", "q", "phi", "theta")
    inputs, outputs = ("lat", "lon"), ("p", "q", "v", "u")
    Y_v = gb.Parameter(-0.1, bounds=(-2, 0))
    X_u = gb.Parameter(-0.05, bounds=(-2, 0))
    L_v = gb.Parameter(-0.09, bounds=(-2, 2))
    L_p = gb.Parameter(-5.0, bounds=(-20, 0))
    L_q = gb.Parameter(1.2, bounds=(-20, 20))
    M_u = gb.Parameter(0.03, bounds=(-2, 2))
    M_p = gb.Parameter(-0.6, bounds=(-20, 20))
    M_q = gb.Parameter(-2.2, bounds=(-20, 0))
    L_lat = gb.Parameter(0.09, bounds=(-2, 2))
    M_lon = gb.Parameter(0.035, bounds=(-2, 2))
    tau = gb.Parameter(0.05, bounds=(0, 0.3))
    delays = {"lat": "tau", "lon": "tau"}

    def derivative(self, x, u, p):
        """Return the derivatives."""
        return (
            p.Y_v * x.v + gb.g * x.phi,
            p.X_u * x.u - gb.g * x.theta,
            p.L_v * x.v + p.L_p * x.p + p.L_q * x.q + p.L_lat * u.lat,
            p.M_u * x.u + p.M_p * x.p + p.M_q * x.q + p.M_lon * u.lon,
            x.p,
            x.q,
        )

    def output(self, x, u, p):
        """Return the outputs."""
        return x.p, x.q, x.v, x.u


def response(seed):
    """Return a response of 20 points with errors of 2 %."""
    draw, omega = np.random.default_rng(seed), np.logspace(-1, 2, 20)
    noise = draw.standard_normal(20) + 1j * draw.standard_normal(20)
    values = 2 / (0.3j * omega + 1) * (1 + 0.02 * noise)
    return gb.FrequencyResponse(omega, values, input="u", output="y")


def record(model, values, seed, samples=400):
    """Return a record of a model with noise of 2 %, driven by a square wave."""
    draw, time_s = np.random.default_rng(seed), np.arange(samples) * 0.02
    drive = gb.Record(time_s, {"u": np.sign(np.sin(3.0 * time_s))})
    simulated = gb.simulate(model, values, drive)
    outputs = {
        name: simulated[name] * (1 + 0.02 * draw.standard_normal(samples)) for name in model.outputs
    }
    return gb.Record(time_s, {"u": drive["u"], **outputs})


def many_responses():
    """Return the responses of all pairs of the coupled model."""
    model, omega, draw = Coupled(), np.geomspace(0.3, 25, 20), np.random.default_rng(0)
    values = {name: p.start for name, p in model.parameters.items()}
    responses = []
    for pair in itertools.product(model.input_names, model.output_names):
        exact = gb.frequency_response(model, values, omega, input=pair[0], output=pair[1])
        noise = draw.standard_normal(20) + 1j * draw.standard_normal(20)
        measured = exact.response * (1 + 0.02 * noise)
        responses.append(gb.FrequencyResponse(omega, measured, input=pair[0], output=pair[1]))
    return gb.several(model, responses)


def members():
    """Return members of every kind."""
    truth = {"K": 2.0, "tau": 0.3}
    tilt = {name: p.start for name, p in LinearTilt().parameters.items()}
    tilt |= {"a1": 10.0, "a2": 3.0, "a3": 5.0}
    flight = gb.Problem(Lag(), record(Lag(), truth, 0))
    spectrum = gb.Problem(
        Lag(), gb.spectral.transient_spectrum(record(Lag(), truth, 3), "u", "y", (0.5, 20))
    )
    return [
        *(gb.study.Member(m.problem(), name=m.__name__) for m in (pitch_hover, roll_hover)),
        *(gb.study.Member(gb.Problem(Lag(), response(k)), 20, name=f"lag {k}") for k in range(3)),
        gb.study.Member(flight, 6, name="record"),
        gb.study.Member(gb.Problem(LinearTilt(), record(LinearTilt(), tilt, 1)), 6, name="tilt"),
        gb.study.Member(flight, 3, name="IPOPT", method=gb.Collocation()),
        gb.study.Member(
            flight + gb.Problem(Lag(), response(9), criterion=gb.RelativeLikelihood()),
            6,
            name="record and response",
        ),
        gb.study.Member(spectrum, 6, name="manoeuvre"),
        gb.study.Member(pitch_hover.problem() + pitch_5deg.problem(), 8, name="two responses"),
        gb.study.Member(many_responses(), 6, name="many responses"),
        gb.study.Member(pitch_hover.problem(), 30, name="IPOPT alone", search="multistart"),
    ]


def said(outcome):
    """Print an outcome for the parent."""
    print(json.dumps(outcome), flush=True)


def work(folder, executor):
    """Run the batch, or without a folder one fit, and say how it ended."""
    # A shell ignores Ctrl-C in programs of the background, and so would this one.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    listed = members()
    with EXECUTORS[executor]() as workers:
        if workers is not None:  # their start takes longer than the fits
            workers.submit(time.time).result()
        call = gb.batch, gb.fit  # imported before the signal
        said("begins")
        try:
            if folder == Path():
                problem = listed[-2].problem
                fit = call[1](problem, 60, executor=workers, progress=False)
                said({"end": "returned", "at": time.time(), "runs": len(fit.runs)})
            else:
                study = call[0](listed, folder, executor=workers, progress=False)
                status = [m.status for m in study.members]
                said({"end": "returned", "at": time.time(), "status": status})
        except KeyboardInterrupt as stopped:
            study, fit = (getattr(stopped, name, None) for name in ("study", "fit"))
            said(
                {
                    "end": type(stopped).__name__,
                    "status": [m.status for m in study.members] if study else None,
                    "reasons": [m.error for m in study.members if m.error] if study else [],
                    "runs": len(fit.runs) if fit else 0,
                }
            )


def interrupted(folder, executor, number, seconds):
    """Send a signal to a program after so many seconds of its work, and return what it says."""
    command = [sys.executable, __file__, "--work", folder, "--executor", executor]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(seconds)
        sent = time.time()
        process.send_signal(number)
        last = process.stdout.read().splitlines()
    end = json.loads(last[-1]) if last else {"end": f"exit status {process.returncode}"}
    # What had returned before is not interrupted any more.
    return end | {"end": "had returned"} if end.get("at", math.inf) < sent else end


def different(study, twin):
    """Return the names of members whose fits or runs differ in any bit."""
    names = []
    for member, other in zip(study.members, twin.members, strict=True):
        fit, same = member.fit, other.fit
        assert fit is not None, (member.name, member.status, member.error)
        assert same is not None
        ends = [[(r.status, *r.estimate.tolist()) for r in each.runs] for each in (fit, same)]
        values = [(each.cost, each.estimate, each.standard_error) for each in (fit, same)]
        if ends[0] != ends[1] or values[0] != values[1]:
            names.append(member.name)
    return names


def arguments():
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moments", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--executor", default="this process", help=argparse.SUPPRESS)
    return parser.parse_args()


def main():
    """Interrupt, resume, compare."""
    options = arguments()
    if options.work is not None:
        work(options.work, options.executor)
        return
    rng = random.Random(options.seed)
    heading = f"interrupt_study.py, greybox {version('greybox-id')}, {time.strftime('%Y-%m-%d')}"
    lines = [f"{heading}, {options.moments} moments, seed {options.seed}"]

    def say(text):
        lines.append(text)
        print(text, flush=True)

    wrong = 0
    with tempfile.TemporaryDirectory() as place:
        listed = members()
        alone = gb.batch(listed, Path(place) / "alone", progress=False)
        took = {}
        for executor, made in EXECUTORS.items():
            with made() as workers:
                if workers is not None:
                    workers.submit(time.time).result()
                began = time.perf_counter()
                study = gb.batch(listed, Path(place) / executor, executor=workers, progress=False)
            took[executor] = time.perf_counter() - began
            say(
                f"{executor}: {took[executor]:.1f} s, {study!r}, differs: {different(study, alone)}"
            )
        for k in range(options.moments):
            executor = [*EXECUTORS][k % 3]
            number = rng.choice(SIGNALS)
            seconds = rng.uniform(0, took[executor])
            folder = Path(place) / f"interrupted {k}"
            end = interrupted(folder, executor, number, seconds)
            if end["end"] == "had returned":  # the machine is faster than at the measurement
                took[executor] = min(took[executor], seconds)
            statuses = Counter(end.get("status") or ())
            study = gb.batch(listed, folder, progress=False)
            names = different(study, alone)
            is_right = end["end"] == "Interrupted" and not statuses["failed"] and not names
            is_right |= end["end"] == "had returned" and statuses["done"] == len(listed)
            wrong += not is_right
            say(
                f"{executor}, {number.name} after {seconds:.2f} s: {end['end']}, {dict(statuses)}; "
                f"resumed: {study!r}, differs: {names}{'' if is_right else ' WRONG ' + str(end)}"
            )
        for k in range(options.moments // 4):
            executor, number = [*EXECUTORS][k % 3], rng.choice(SIGNALS)
            seconds = rng.uniform(0, 1.0)
            end = interrupted(Path(), executor, number, seconds)
            is_right = end["end"] in ("Interrupted", "had returned")
            wrong += not is_right
            say(
                f"fit, {executor}, {number.name} after {seconds:.2f} s: {end['end']} with "
                f"{end.get('runs')} runs{'' if is_right else ' WRONG'}"
            )
    say(f"{wrong} of {options.moments + options.moments // 4} wrong")
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
