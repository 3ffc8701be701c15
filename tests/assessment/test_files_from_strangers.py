"""What SECURITY.md promises of files: a reduced form of `benchmarks/fuzz_results.py`."""

import os
from pathlib import Path

import numpy as np
import pytest
from benchmark_module import benchmark
from crafted_results import CRAFTED_LOGS, craft
from sealing import seal

import greybox as gb

# One of each kind; the benchmark has them all.
KINDS = [
    "external link",
    "external pipe",
    "virtual dataset",
    "8 TB declared",
    "4 GB never written",
    "a chunk of 2 GB",
    "a chunk that inflates",
    "hard links",
    "escapes",
    "a module",
    "a model of order 1e6",
    "deep JSON",
    "numbers for names",
    "a minimum far away",
    "lists for numbers",
    "a shape of 8 TB",
    "a wide shape of nothing",
    "a shape without end",
    "not finite",
]


@pytest.fixture(scope="module")
def fuzzer():
    return benchmark("fuzz_results")


@pytest.fixture(scope="module")
def whole(fuzzer, tmp_path_factory):
    path = tmp_path_factory.mktemp("sound") / "sound.h5"
    fuzzer.sound(path)
    return path


def test_a_sound_file_is_read(fuzzer, whole):
    assert fuzzer.outcome_of(whole) == ("read", "")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
@pytest.mark.parametrize("name", KINDS)
def test_a_crafted_file_is_refused_in_a_sentence_or_harmless(
    fuzzer, whole, tmp_path, monkeypatch, name
):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    craft(name, whole, tmp_path / "crafted.h5")
    word, details = fuzzer.outcome_of(tmp_path / "crafted.h5", name in CRAFTED_LOGS)
    assert word in ("read", "refused"), details
    assert not Path("EXECUTED").exists()


def test_damaged_files_that_were_sealed_again_end_in_a_sentence_or_print(fuzzer, whole, tmp_path):
    raw = whole.read_bytes()
    path = tmp_path / "damaged.h5"
    for number in range(4):
        path.write_bytes(fuzzer.mutated(np.random.default_rng((11, number)), raw))
        seal(path)
        word, details = fuzzer.outcome_of(path)
        assert word in ("read", "refused"), (number, word, details)


def test_names_are_printed_without_what_a_terminal_obeys(whole, tmp_path):
    craft("escapes", whole, tmp_path / "crafted.h5")
    fit = gb.load(tmp_path / "crafted.h5")
    assert str(fit).replace("\n", "").isprintable()
    assert fit.name == r"\x1b]0;PWNED\x07\x1b[2J\x1b[31mhello"
    assert fit.parts[0].label == r"\x1b]52;c;ZXZpbA==\x07x\x1b[1A\x1b[2Kfake"
