"""The function that is translated to C against differences of single samples, and what is said where it cannot be."""

import re

import casadi as ca
import numpy as np
import pytest
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose

from greybox.compiled.code_generation import _linearization, compiled

LENGTH = 4


def sample():
    """Three states, of which the last follows neither the others nor a parameter, four parameters, two residuals."""
    x, q, d = ca.SX.sym("x", 3), ca.SX.sym("q", 4), ca.SX.sym("d", 3)
    after = ca.vertcat(
        0.9 * x[0] + 0.1 * q[2] * ca.sin(x[1]), q[0] * x[1] + d[0] ** 2, 0.5 * x[2] + d[1]
    )
    residuals = ca.vertcat(d[2] - x[0] * x[2], d[0] - q[3] * x[1])
    return ca.Function("sample", [x, q, d], [after, residuals, ca.sin(x)])


@pytest.mark.parametrize("active", [[2, 0, 3], [0], []])
def test_a_segment_has_the_derivatives_and_products_of_its_samples(active):
    random = np.random.default_rng(1)
    node, q, weight, data = (random.normal(size=size) for size in (3, 4, (2, 2), (3, LENGTH)))
    one = sample()

    def run(values):
        x, parameters, errors = values[:3], q.copy(), []
        parameters[active] = values[3:]
        for column in data.T:
            x, e, _ = (v.full().ravel() for v in one(x, parameters, column))
            errors.append(weight @ e)
        return np.concatenate([x, *errors])

    at = np.concatenate([node, q[active]])
    values, slopes = run(at), numeric_jacobian(run, at)
    J, e = slopes[3:], values[3:]
    end, transition, products, gradient = (
        v.full().ravel() for v in _linearization(one, active, LENGTH)(node, q, weight, data)
    )
    assert_allclose(end, values[:3])
    assert_allclose(transition.reshape(-1, 3).T, slopes[:3], rtol=1e-7, atol=1e-9)
    assert_allclose(products, (J.T @ J)[np.triu_indices(len(at))], rtol=1e-7, atol=1e-9)
    assert_allclose(gradient, J.T @ e, rtol=1e-7, atol=1e-9)


def function(factor):
    x = ca.SX.sym("x")
    return ca.Function("twice", [x], [factor * x])


def test_a_compiler_that_is_missing_or_fails_is_told(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PATH", str(tmp_path))
    missing = "compile=True needs a C compiler and none of cc, gcc, clang was found: install one, or leave out compile=True."
    with pytest.raises(RuntimeError, match=f"^{re.escape(missing)}$"):
        compiled(function(2.0))
    compiler = tmp_path / "gcc"
    compiler.write_text("#!/bin/sh\necho no space left >&2\nexit 3\n")
    compiler.chmod(0o755)
    failed = f"{compiler} failed: no space left; leave out compile=True."
    with pytest.raises(RuntimeError, match=f"^{re.escape(failed)}$"):
        compiled(function(2.0))


def test_what_was_compiled_is_kept_by_its_content(monkeypatch, tmp_path):
    """Without a compiler the second time; another function of the same name is another one."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    twice, thrice = compiled(function(2.0)), compiled(function(3.0))
    assert (float(twice(1.5)), float(thrice(1.5))) == (3.0, 4.5)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert float(compiled(function(3.0))(2.0)) == 6.0
