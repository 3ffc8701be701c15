"""Result files as somebody who means harm could send them.

A sound one, changed and sealed again.
"""

import json
import shutil
import zlib

import h5py
import numpy as np
from sealing import seal

SECRET = "first line of a file that nobody was to see\n"


def replaced(place, **options):
    """Put another dataset in the place of one."""

    def change(file):
        del file[place]
        file.create_dataset(place, **options)

    return change


def rewritten(text):
    """Put another text in the place of the JSON."""
    return lambda file: file["fit"].__setitem__(0, text)


def values(*place, **values):
    """Put other values into the JSON, into the object at a place."""

    def change(file):
        fit = json.loads(file["fit"].asstr()[0])
        item = fit
        for key in place:
            item = item[key]
        item.update(values)
        file["fit"][0] = json.dumps(fit)

    return change


def linked(place, link):
    def change(file):
        del file[place]
        file[place] = link

    return change


def model(target, arguments=(), keywords=None):
    stored = {"class": target, "arguments": arguments, "keywords": keywords or {}}
    return values("parts", 0, model=stored)


def virtual(file):
    shape = file["covariance"].shape
    del file["covariance"]
    layout = h5py.VirtualLayout(shape=shape, dtype="f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", shape=shape)
    file.create_virtual_dataset("covariance", layout)


def external_numbers(name):
    def change(file):
        shape = file["covariance"].shape
        del file["covariance"]
        size = 8 * shape[0] * shape[1]
        file.create_dataset("covariance", shape=shape, dtype="f8", external=[(name, 0, size)])

    return change


def compressed_zeros(file):
    """1 GB of zeros in a file of 1 MB."""
    del file["covariance"]
    made = file.create_dataset(
        "covariance",
        shape=(16000, 8000),
        dtype="f8",
        chunks=(4000, 4000),
        compression="gzip",
    )
    made[:4000, :4000] = 0
    _, chunk = made.id.read_direct_chunk((0, 0))
    for row in range(0, 16000, 4000):
        for column in range(0, 8000, 4000):
            made.id.write_direct_chunk((row, column), chunk)


def inflated_chunk(file):
    """A chunk that holds far more than its size says."""
    del file["covariance"]
    made = file.create_dataset(
        "covariance", shape=(4, 4), dtype="f8", chunks=(4, 4), compression="gzip"
    )
    packed = zlib.compressobj(1)
    zeros = bytes(2**24)
    made.id.write_direct_chunk(
        (0, 0), b"".join(packed.compress(zeros) for _ in range(20)) + packed.flush()
    )


def many_parts(link):
    def change(file):
        for k in range(2, 20_000):
            file[f"parts/{k}"] = h5py.SoftLink("/parts/0") if link == "soft" else file["parts/0"]

    return change


def many_attributes(file):
    group = file.create_group("more", track_order=True)
    for k in range(2000):
        group.attrs[f"a{k}"] = k


def deep(file):
    group = file
    for _ in range(500):
        group = group.create_group("g")


def escapes(file):
    values(name="\x1b]0;PWNED\x07\x1b[2J\x1b[31mhello", starts="\u202efdp.\x9b2J")(file)
    values("quantities", 0, unit="\x1b[8m")(file)
    for k in range(len(file["parts"])):
        label = "\x1b]52;c;ZXZpbA==\x07x\x1b[1A\x1b[2Kfake"
        values("parts", k, label=label, rule="rule\r\n\x08\x7f")(file)


def two_equal_names(file):
    name = json.loads(file["fit"].asstr()[0])["quantities"][1]["name"]
    values("quantities", 0, name=name)(file)


ARRAY = "covariance"
CRAFTED = {
    "external link": linked(ARRAY, h5py.ExternalLink("other.h5", "x")),
    "external link to a group": linked("parts", h5py.ExternalLink("other.h5", "/")),
    "external text": replaced("fit", shape=(1,), dtype="S64", external=[("secret.txt", 0, 64)]),
    "external numbers": external_numbers("secret.txt"),
    "external pipe": external_numbers("pipe"),
    "virtual dataset": virtual,
    "8 TB declared": replaced(ARRAY, shape=(10**6, 10**6), dtype="f8", chunks=(1000, 1000)),
    "4 GB declared": replaced(ARRAY, shape=(23_000, 23_000), dtype="f8", chunks=(1000, 1000)),
    "4 GB never written": replaced(ARRAY, shape=(23_000, 23_000), dtype="f8"),
    "a chunk of 2 GB": replaced(
        "runs/cost", shape=(1,), maxshape=(None,), dtype="f8", chunks=(2**28,)
    ),
    "1 GB of zeros": compressed_zeros,
    "a chunk that inflates": inflated_chunk,
    "soft link to itself": linked("covariance", h5py.SoftLink("/covariance")),
    "hard link to the root": lambda file: file.__setitem__("parts/0/root", file["/"]),
    "soft links": many_parts("soft"),
    "hard links": many_parts("hard"),
    "many attributes": many_attributes,
    "deep groups": deep,
    "escapes": escapes,
    "a text of 100 MB": values("quantities", 0, unit="m" * 10**8),
    "a name of 1 MB": values(name="\x1b" * 2**20),
    "a million texts": replaced("fit", shape=(10**6,), dtype=h5py.string_dtype()),
    "a module": model("evil_side_effect:X"),
    "a standard module": model("this:X"),
    "a model of order 1e6": model("greybox.models.polynomial:Polynomial", [10**6, 1]),
    "no class": model("nothing"),
    "deep JSON": rewritten("[" * 60_000 + "]" * 60_000),
    "a number of a million digits": rewritten("1" * 10**6),
    "a list for a model": values("parts", 0, model=[1, 2]),
    "names for arguments": model("greybox.models.tilt:Tilt", {"a": 1}),
    "a list for versions": values(versions=[1]),
    "texts for costs": values(costs={"a": "b"}),
    "a number for names": values(notes=5),
    "numbers for names": values(warnings=[1, 2]),
    "a number for a fit": replaced("fit", data=np.arange(6)),
    "bytes for a fit": replaced("fit", data=np.void(b"abc")),
    "no kind of part": values("parts", 0, fitted=None),
    "a layout below zero": lambda file: file.attrs.__setitem__("layout", -1),
    "no finite cost": values(cost=float("nan"), seconds=float("inf")),
    "two equal names": two_equal_names,
    "a minimum that is not there": values("minima", 0, runs=[99]),
    "a minimum far away": values("minima", 0, runs=[2**40]),
    "complex numbers": replaced(ARRAY, data=np.ones((4, 4)) * 1j),
    "references": lambda file: replaced(ARRAY, data=np.array([file.ref] * 4, dtype=h5py.ref_dtype))(
        file
    ),
    "records for numbers": replaced(
        ARRAY, data=np.array([(1, b"a")], dtype=[("a", "f8"), ("b", "S1")])
    ),
    "another shape": replaced(ARRAY, data=np.ones((1, 1))),
    "another rank": replaced("runs/start", data=np.ones((3, 2, 2))),
    "a group for numbers": lambda file: (file.__delitem__(ARRAY), file.create_group(ARRAY)),
    "not finite": replaced(ARRAY, data=np.full((3, 3), np.inf)),
}


def craft(name, sound, path):
    """Write the crafted file `name`, made from the sound one, and beside it what it aims at."""
    shutil.copy(sound, path)
    folder = path.parent
    (folder / "secret.txt").write_text(SECRET * 20)
    with h5py.File(folder / "other.h5", "w") as file:
        file["x"] = np.eye(4) * 1e6
    (folder / "evil_side_effect.py").write_text("open('EXECUTED', 'w').close()\n")
    with h5py.File(path, "a") as file:
        CRAFTED[name](file)
    seal(path, "fit")
