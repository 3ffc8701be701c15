"""Saved fits and HDF5 logs as somebody who means harm could send them.

A sound one, changed, and a fit sealed again.
"""

import json
import zlib

import h5py
import numpy as np

from greybox.data.files.sealed_files import read_sealed, write_sealed

SECRET = "first line of a file that nobody was to see\n"


# --- changes of a fit, which is a list: layout, checksum and fields


def rewritten(text):
    """Put another text in the place of the whole JSON."""
    return lambda stored: text


def values(*place, **values):
    """Put other values into the fields, into the object at a place."""

    def change(stored):
        item = stored[2]
        for key in place:
            item = item[key]
        item.update(values)

    return change


def stated(layout=None, checksum=None):
    """Put another layout or checksum before the fields."""

    def change(stored):
        stored[:2] = [
            new if new is not None else old
            for new, old in zip((layout, checksum), stored, strict=False)
        ]

    return change


def numbers(*place, shape, numbers):
    """Put another array into the fields."""
    *place, name = place
    return values(*place, **{name: {"shape": shape, "numbers": numbers}})


def model(target, arguments=(), keywords=None):
    stored = {"class": target, "arguments": arguments, "keywords": keywords or {}}
    return values("parts", 0, model=stored)


def escapes(stored):
    values(name="\x1b]0;PWNED\x07\x1b[2J\x1b[31mhello", starts="\u202efdp.\x9b2J")(stored)
    values("quantities", 0, unit="\x1b[8m")(stored)
    for k in range(len(stored[2]["parts"])):
        label = "\x1b]52;c;ZXZpbA==\x07x\x1b[1A\x1b[2Kfake"
        values("parts", k, label=label, rule="rule\r\n\x08\x7f")(stored)


def two_equal_names(stored):
    values("quantities", 0, name=stored[2]["quantities"][1]["name"])(stored)


ARRAY = "covariance"
CRAFTED = {
    "escapes": escapes,
    "a text of 10 MB": values("quantities", 0, unit="m" * 10**7),
    "a name of 1 MB": values(name="\x1b" * 2**20),
    "many texts": values(notes=["x"] * 10**5),
    "a module": model("evil_side_effect:X"),
    "a standard module": model("this:X"),
    "a model of order 1e6": model("greybox.models.polynomial:Polynomial", [10**6, 1]),
    "no class": model("nothing"),
    "deep JSON": rewritten("[" * 60_000 + "]" * 60_000),
    "a number of a million digits": rewritten("1" * 10**6),
    "no list": rewritten("{}"),
    "a text for a layout": stated(layout="x"),
    "a layout below zero": stated(layout=-1),
    "a list for a model": values("parts", 0, model=[1, 2]),
    "names for arguments": model("greybox.models.tilt:Tilt", {"a": 1}),
    "a list for versions": values(versions=[1]),
    "a number for names": values(notes=5),
    "numbers for names": values(warnings=[1, 2]),
    "no kind of part": values("parts", 0, fitted=None),
    "no finite cost": values(cost=float("nan"), seconds=float("inf")),
    "two equal names": two_equal_names,
    "a minimum that is not there": values("minima", 0, runs=[99]),
    "a minimum far away": values("minima", 0, runs=[2**40]),
    "no numbers": values(covariance=None),
    "a number for numbers": values(covariance=1.0),
    "texts for numbers": numbers(ARRAY, shape=[1, 1], numbers=["a"]),
    "lists for numbers": numbers(ARRAY, shape=[1, 1], numbers=[[1], [2, 3]]),
    "a shape of 8 TB": numbers(ARRAY, shape=[10**6, 10**6], numbers=[0.0]),
    "a wide shape of nothing": numbers(ARRAY, shape=[0, 2**60], numbers=[]),
    "a shape without end": numbers(ARRAY, shape=[2**80], numbers=[]),
    "another shape": numbers(ARRAY, shape=[1, 1], numbers=[1.0]),
    "another rank": numbers("runs", "start", shape=[3, 2, 2], numbers=[1.0] * 12),
    "not finite": numbers(ARRAY, shape=[3, 3], numbers=[float("inf")] * 9),
}


# --- changes of a log


def replaced(place, **options):
    """Put another dataset in the place of one."""

    def change(file):
        del file[place]
        file.create_dataset(place, **options)

    return change


def linked(place, link):
    def change(file):
        del file[place]
        file[place] = link

    return change


def virtual(file):
    shape = file["x"].shape
    del file["x"]
    layout = h5py.VirtualLayout(shape=shape, dtype="f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", shape=shape)
    file.create_virtual_dataset("x", layout)


def external_numbers(name):
    def change(file):
        shape = file["x"].shape
        del file["x"]
        size = 8 * shape[0]
        file.create_dataset("x", shape=shape, dtype="f8", external=[(name, 0, size)])

    return change


def compressed_zeros(file):
    """1 GB of zeros in a file of 1 MB."""
    del file["x"]
    made = file.create_dataset(
        "x",
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
    del file["x"]
    # HDF5 1.14.2 writes the length of a chunk of 128 bytes in two bytes, and of this one in three.
    made = file.create_dataset("x", shape=(32, 32), dtype="f8", chunks=(32, 32), compression="gzip")
    packed = zlib.compressobj(1)
    zeros = bytes(2**24)
    made.id.write_direct_chunk(
        (0, 0), b"".join(packed.compress(zeros) for _ in range(8)) + packed.flush()
    )


def many_links(link):
    def change(file):
        root, more = file["/"], file.create_group("more")
        links = more.id.links  # by paths of h5py, it would take seconds
        for k in range(20_000):
            if link == "soft":
                links.create_soft(b"%d" % k, b"/x")
            else:
                links.create_hard(b"%d" % k, root.id, b"x")

    return change


def deep(file):
    group = file
    for _ in range(500):
        group = group.create_group("g")


CRAFTED_LOGS = {
    "external link": linked("x", h5py.ExternalLink("other.h5", "x")),
    "external link to a group": linked("x", h5py.ExternalLink("other.h5", "/")),
    "external numbers": external_numbers("secret.txt"),
    "external pipe": external_numbers("pipe"),
    "virtual dataset": virtual,
    "8 TB declared": replaced("x", shape=(10**6, 10**6), dtype="f8", chunks=(1000, 1000)),
    "4 GB never written": replaced("x", shape=(23_000, 23_000), dtype="f8"),
    "a chunk of 2 GB": replaced("x", shape=(1,), maxshape=(None,), dtype="f8", chunks=(2**28,)),
    "1 GB of zeros": compressed_zeros,
    "a chunk that inflates": inflated_chunk,
    "soft link to itself": linked("x", h5py.SoftLink("/x")),
    "hard link to the root": lambda file: file.__setitem__("root", file["/"]),
    "soft links": many_links("soft"),
    "hard links": many_links("hard"),
    "deep groups": deep,
    "references": lambda file: replaced("x", data=np.array([file.ref] * 4, dtype=h5py.ref_dtype))(
        file
    ),
}


def craft(name, sound, path):
    """Write the crafted file `name`, and beside it what it aims at; a fit from the sound one."""
    folder = path.parent
    (folder / "secret.txt").write_text(SECRET * 20)
    with h5py.File(folder / "other.h5", "w") as file:
        file["x"] = np.eye(4) * 1e6
    (folder / "evil_side_effect.py").write_text("open('EXECUTED', 'w').close()\n")
    if name in CRAFTED_LOGS:
        with h5py.File(path, "w") as file:
            file["time"], file["x"] = np.arange(4.0), np.arange(4.0)
            CRAFTED_LOGS[name](file)
    else:
        change_fit(sound, path, CRAFTED[name])


def change_fit(sound, path, change):
    """Change the text of a saved fit, and seal it again."""
    stored = json.loads(read_sealed(sound))
    text = change(stored)
    write_sealed(path, (json.dumps(stored) if text is None else text).encode())
