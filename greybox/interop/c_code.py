"""A model at its estimate as C source: CasADi writes the formulas, and functions with plain arrays go around them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from greybox.files.safe_files import write_text
from greybox.files.text_table import printable
from greybox.interop.linear_systems import GivenModel, given_model
from greybox.interop.source_names import identifier, identifiers
from greybox.modeling.integrators import RungeKutta
from greybox.modeling.realization import Dynamics

Array = np.ndarray[Any, np.dtype[np.float64]]

HEADER = """\
/* {title}
 *
 * {about}
 *
 * x' = derivative(x, u), y = output(x, u), in SI units; plain C99, without allocation or other state.
 *
 * Example: a step of the first input, sampled at 100 Hz. Compile it with: cc example.c {file}.c -lm
 *
 *   #include <stdio.h>
 *   #include "{file}.h"
 *
 *   int main(void) {{
 *     double x[{upper}_STATES + 1] = {{0}}, u[{upper}_INPUTS] = {{1.0}}, y[{upper}_OUTPUTS];
 *     for (int k = 0; k < 100; k++) {{
 *       {name}_output(x, u, y);
 *       printf("%g %g\\n", 0.01 * k, y[0]);
 *       {name}_step(x, u, 0.01);
 *     }}
 *     return 0;
 *   }}
 */
#ifndef {upper}_H
#define {upper}_H

#ifdef __cplusplus
extern "C" {{
#endif

enum {{ {upper}_STATES = {n}, {upper}_INPUTS = {m}, {upper}_OUTPUTS = {k} }};
{indices}
/* dx[{n}] from x[{n}] and u[{m}]. */
void {name}_derivative(const double *x, const double *u, double *dx);

/* y[{k}] from x[{n}] and u[{m}]. */
void {name}_output(const double *x, const double *u, double *y);

/* Advance x[{n}] by `step` seconds with u[{m}] held: one step of the classical Runge-Kutta method. */
void {name}_step(double *x, const double *u, double step);

#ifdef __cplusplus
}}
#endif

#endif
"""


def write_c(
    thing: Any,
    path: str | Path,
    values: Mapping[str, float] | None = None,
    *,
    pade: int | None = None,
    part: int = 0,
) -> tuple[Path, Path]:
    """Write a model at its estimate as C source that needs no other library, and return the two files.

    ``tilt.c`` and ``tilt.h`` have ``tilt_derivative``, ``tilt_output`` and ``tilt_step``, which
    advances the states by a step of your choice; a complete example stands at the beginning of
    ``tilt.h``. Files that exist are replaced.

    Parameters
    ----------
    thing : Fit or Model
    path : str or Path
        Ending in .c; its name begins those of the functions.
    values : mapping of name to float, optional
        Of a model: values of its parameters, by default the declared starts.
    pade : int, optional
        Order of the Padé approximation of delays; 0 leaves delays out, for who delays the input
        before the call.
    part : int
        Of a fit.

    Raises
    ------
    ValueError, TypeError
        For another ending, a delay without `pade`, or what cannot be converted.
    OSError
        If the folder cannot be written.
    """
    path = Path(path)
    if path.suffix != ".c":
        raise ValueError(f"{path} is to be C source: end it in .c.")
    given = given_model(thing, values, None, part)
    system, p = given.ode(pade, "C code of states and inputs")
    name = identifier(path.stem)
    write_text(path.with_suffix(".h"), _header(given, system, p, path.stem, name))
    write_text(path, _source(system, p, path.stem, name))
    return path, path.with_suffix(".h")


def _header(given: GivenModel, system: Dynamics, p: Array, file: str, name: str) -> str:
    numbers = ", ".join(
        f"{parameter} = {value:.6g}"
        for parameter, value in zip(system.parameters, p.tolist(), strict=True)
    )
    title = f"{given.model.label}{f', fitted to {given.name}' if given.name else ''}, written by greybox."
    kinds = {"state": system.states, "input": system.inputs, "output": system.outputs}
    indices = []
    for kind, names in kinds.items():
        places = [
            f"{name.upper()}_{kind.upper()}_{known} = {i}"
            for i, known in enumerate(identifiers(names).values())
        ]
        indices += [f"enum {{ {', '.join(places)} }};"] if places else []
    texts = {"title": _comment(title), "about": _comment(numbers or "It has no parameters.")}
    sizes = {"n": len(system.states), "m": len(system.inputs), "k": len(system.outputs)}
    lines = "\n".join(indices) + "\n"
    return HEADER.format(**texts, **sizes, file=file, name=name, upper=name.upper(), indices=lines)


def _comment(text: str) -> str:
    """Return a text that does not end the comment in which it stands: names come from files."""
    return printable(text).replace("*/", "* /").replace("/*", "/ *")


def _source(system: Dynamics, p: Array, file: str, name: str) -> str:
    x, u, h = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs)), ca.SX.sym("h")
    held = ca.SX.zeros(len(system.inputs))
    formulas = {
        "derivative": ([x, u], system.derivative(x, u, p)),
        "output": ([x, u], system.output(x, u, p)),
        "step": ([x, u, h], RungeKutta().advance(system, x, u, held, p, h)),
    }
    generator = ca.CodeGenerator(f"{name}_formulas", {"with_header": False})
    functions = {}
    for what, (arguments, result) in formulas.items():
        functions[what] = ca.Function(f"{name}_formula_{what}", arguments, [result])
        generator.add(functions[what])
    calls = {
        "derivative": ("const double *x, const double *u, double *dx", ("x", "u"), "dx"),
        "output": ("const double *x, const double *u, double *y", ("x", "u"), "y"),
        "step": ("double *x, const double *u, double step", ("x", "u", "&step"), "x"),
    }
    wrappers = [_wrapper(functions[what], f"{name}_{what}", *call) for what, call in calls.items()]
    return "\n".join([f'#include "{file}.h"\n', generator.dump(), *wrappers])


def _wrapper(
    function: ca.Function, name: str, signature: str, arguments: tuple[str, ...], result: str
) -> str:
    """Return a function with plain arrays around one of CasADi's, which wants memory to work in."""
    sizes = (function.sz_arg(), function.sz_res(), function.sz_iw(), function.sz_w())
    arg, res, iw, w = (max(size, 1) for size in sizes)
    places = [f"  arg[{k}] = {argument};" for k, argument in enumerate(arguments)]
    lines = [
        f"void {name}({signature}) {{",
        f"  const casadi_real *arg[{arg}] = {{0}};",
        f"  casadi_real *res[{res}] = {{0}};",
        f"  casadi_int iw[{iw}];",
        f"  casadi_real w[{w}];",
        *places,
        f"  res[0] = {result};",
        f"  {function.name()}(arg, res, iw, w, 0);",
        "}",
    ]
    return "\n".join(lines) + "\n"
