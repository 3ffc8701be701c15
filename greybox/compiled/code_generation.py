"""CasADi functions as C, compiled once and kept for the next time: that of a search, the linearization of records."""

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.library_cache import keep_library, kept_library
from greybox.files.arrays import Array

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-O2", "-fPIC", "-shared")
NAME = "linearization_of_all"


class CompiledLinearization:
    """For s segments of some samples: ends, their derivatives, and JᵀJ and Jᵀe, all in one loop.

    `sample` is (x, q, d) -> next state, residuals, outputs; `active` names the parameters of the
    derivatives.
    """

    def __init__(
        self,
        sample: ca.Function,
        active: list[int],
        segments: int,
        length: int,
        *,
        each: bool = False,
    ) -> None:
        """Take the function from the cache where it was compiled before, otherwise compile it.

        With `each`, every segment has parameters and a weight for itself.

        Raises
        ------
        RuntimeError
            See `compiled`.
        """
        n, v = sample.size1_in(0), sample.size1_in(0) + len(active)
        self._segments, self._sizes = segments, [n, n * v, v * (v + 1) // 2, v]

        def linearization() -> ca.Function:
            one = _linearization(sample, active, length)
            return one.map(NAME, "serial", segments, [] if each else [1, 2], [])

        self._function = _kept(
            NAME, (sample.serialize(), active, segments, length, each), linearization
        )

    def __call__(self, nodes: Array, q: Array, weight: Array, data: Array) -> list[Array]:
        """Return ends (s, n), derivatives (s, v, n), products (s, v (v + 1) / 2) and gradients (s, v).

        From nodes (s, n), parameters, weights (k, k) and data (samples, width), in the order of the
        samples; with parameters (s, q) and weights (s, k, k) for every segment.
        """
        buffer: Any
        buffer, evaluate = self._function.buffer()
        inputs = [
            np.ascontiguousarray(value, dtype=float)
            for value in (nodes, q, np.swapaxes(weight, -1, -2), data)
        ]
        results = [np.empty((self._segments, size)) for size in self._sizes]
        for k, value in enumerate(inputs):
            buffer.set_arg(k, value.data)
        for k, value in enumerate(results):
            buffer.set_res(k, value.data)
        evaluate()
        return results


def compiled(function: ca.Function) -> ca.Function:
    """Return a function as C.

    Taken from the cache where it was compiled before: ``greybox`` in the folder that XDG_CACHE_HOME
    names, by default ``~/.cache``. What is loaded runs with all rights of the user, so nobody else
    may write there; see `library_cache`.

    Raises
    ------
    RuntimeError
        If there is no C compiler or it fails, or the cache belongs to somebody else.
    """
    return _kept(function.name(), (function.serialize(),), lambda: function)


def _kept(name: str, what: tuple[Any, ...], build: Callable[[], ca.Function]) -> ca.Function:
    """Return the compiled function that `what` identifies; it is built where it is not in the cache."""
    identity = (*what, FLAGS, ca.CasadiMeta.version(), platform.machine())
    key = hashlib.sha256(repr(identity).encode()).hexdigest()[:32]
    path = kept_library(key) or keep_library(key, _library(build()))
    return ca.external(name, str(path))


def _linearization(sample: ca.Function, active: list[int], length: int) -> ca.Function:
    """Return (node, q, weight, data) -> end, its derivatives, products and gradient of a segment."""
    x, q, d = (ca.SX.sym(name, sample.numel_in(k)) for k, name in enumerate("xqd"))
    after, e, _ = sample(x, q, d)
    n, k, free = x.numel(), e.numel(), ca.vertcat(x, q[active])
    v = free.numel()
    A, E, W = ca.jacobian(after, free), ca.jacobian(e, free), ca.SX.sym("W", k, k)
    S = ca.SX.sym("S", _pattern(A, n, v))
    H, g = ca.SX.sym("H", v * (v + 1) // 2), ca.SX.sym("g", v)
    J = W @ (E[:, :n] @ S + ca.horzcat(ca.SX(k, n), E[:, n:]))
    S_next = ca.project(A[:, :n] @ S + ca.horzcat(ca.SX(n, n), A[:, n:]), S.sparsity())
    products = J.T @ J
    upper = ca.vertcat(ca.SX(0, 1), *[products[i, c] for i in range(v) for c in range(i, v)])
    before: list[Any] = [x, *S.nonzeros(), H, g]
    then: list[Any] = [after, *S_next.nonzeros(), H + upper, g + J.T @ (W @ e)]
    step = ca.Function("step", [ca.vertcat(*before), q, W, d], [ca.vertcat(*then)], {"cse": True})
    node, Q, D = ca.MX.sym("x", n), ca.MX.sym("q", q.numel()), ca.MX.sym("d", d.numel(), length)
    weight, eye = ca.MX.sym("W", k, k), np.eye(n, v)
    row, column = S.sparsity().get_triplet()
    first = ca.DM([eye[i, c] for i, c in zip(row, column, strict=True)])
    last = step.fold(length)(ca.vertcat(node, first, ca.MX.zeros(H.numel() + v)), Q, weight, D)
    ends = np.cumsum([n, S.nnz(), H.numel(), v]).tolist()
    end, slopes, summed, gradient = ca.vertsplit(last, [0, *ends])
    full = ca.vec(ca.densify(ca.MX(S.sparsity(), slopes)))
    return ca.Function("linearization", [node, Q, weight, D], [end, full, summed, gradient])


def _pattern(A: ca.SX, n: int, v: int) -> ca.Sparsity:
    """Return where the derivatives of a state by node and parameters may differ from zero, after any steps."""
    one, pattern = ca.DM(A.sparsity(), 1), ca.sparsify(ca.DM(np.eye(n, v)))
    for _ in range(v):
        pattern = ca.DM(
            (pattern + one[:, :n] @ pattern + ca.horzcat(ca.DM(n, n), one[:, n:])).sparsity(), 1
        )
    return pattern.sparsity()


def _library(function: ca.Function) -> bytes:
    """Translate the function to C, compile it, and return the library."""
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        raise RuntimeError(
            f"compile=True needs a C compiler and none of {', '.join(COMPILERS)} was found: "
            "install one, or leave out compile=True."
        )
    with tempfile.TemporaryDirectory() as folder:
        generator = ca.CodeGenerator("function.c", {"with_header": False})
        generator.add(function)
        source, fresh = generator.generate(folder + os.sep), Path(folder) / "function.so"
        command = [compiler, *FLAGS, "-o", str(fresh), source, "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(
                f"{compiler} failed: {done.stderr.strip()[:300]}; leave out compile=True."
            )
        return fresh.read_bytes()
