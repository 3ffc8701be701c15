"""A model at its estimate as C source: formulas by CasADi, in functions with plain arrays."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from greybox.files.arrays import Array
from greybox.files.safe_files import write_text
from greybox.files.text_table import printable
from greybox.interop.linear_systems import GivenModel, given_model
from greybox.interop.source_names import identifier, identifiers
from greybox.modeling.formula_structure import has_switches
from greybox.modeling.held_inputs import held_response
from greybox.modeling.integrators import RungeKutta
from greybox.modeling.realization import Dynamics

HEADER = """\
/* {title}
 *
 * {about}
 *
 * x' = derivative(x, u), y = output(x, u), in SI units; plain C99, without allocation.
 *
 * Example: a step of the first input. Compile it with: cc example.c {file}.c -lm
 *
 *   #include <stdio.h>
 *   #include "{file}.h"
 *
 *   int main(void) {{
 *     double x[{upper}_STATES + 1] = {{0}}, u[{upper}_INPUTS] = {{1.0}}, y[{upper}_OUTPUTS];
 *     for (int k = 0; k < 100; k++) {{
 *       {name}_output(x, u, y);
 *       printf("%g %g\\n", {upper}_STEP * k, y[0]);
 *       {name}_step(x, u);
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
#define {upper}_STEP {step!r} /* s */
{indices}
/* dx[{n}] from x[{n}] and u[{m}]. */
void {name}_derivative(const double *x, const double *u, double *dx);

/* y[{k}] from x[{n}] and u[{m}]. */
void {name}_output(const double *x, const double *u, double *y);

/* Advance x[{n}] by {upper}_STEP with u[{m}] held: {method}. */
void {name}_step(double *x, const double *u);

#ifdef __cplusplus
}}
#endif

#endif
"""

# A step is in place: the result of each substep is the state of the next one.
WRAPPER = """\
void {name}({arguments}) {{
  const casadi_real *arg[{}] = {{0}};
  casadi_real *res[{}] = {{0}};
  casadi_int iw[{}];
  casadi_real w[{}];
  for (int k = 0; k < {count}; k++) {{
    arg[0] = x;
    arg[1] = u;
    res[0] = {result};
    {function}(arg, res, iw, w, 0);
  }}
}}
"""


def write_c(
    thing: Any,
    path: str | Path,
    values: Mapping[str, float] | None = None,
    *,
    step: float = 0.01,
    pade: int | None = None,
    part: int = 0,
) -> tuple[Path, Path]:
    """Write a model at its estimate as C source without dependencies; return the two files.

    ``tilt.c`` and ``tilt.h`` have ``tilt_derivative``, ``tilt_output`` and ``tilt_step``, which
    advances the states by `step` with the inputs held. A linear model, with the Padé approximation
    of its delays, is discretized exactly. A nonlinear one takes as many substeps of the classical
    Runge-Kutta method as its fastest mode at rest needs. A complete example stands at the beginning
    of ``tilt.h``. Existing files are replaced.

    Parameters
    ----------
    thing : Fit or Model
    path : str or Path
        Ends in .c; its name begins those of the functions.
    values : mapping of name to float, optional
        Parameters of a model, by default the declared starts.
    step : float
        Sampling time, s.
    pade : int, optional
        Order of the Padé approximation of delays; 0 leaves delays out, for inputs that are delayed
        before the call.
    part : int
        Part of a fit.

    Raises
    ------
    ValueError, TypeError
        For another ending, a step that is not above 0 or far too long for the model, a delay
        without `pade`, or what cannot be converted.
    OSError
        If the folder cannot be written.
    """
    path = Path(path)
    if path.suffix != ".c":
        raise ValueError(f"{path} is to be C source: end it in .c.")
    if not 0 < step < math.inf:
        raise ValueError(f"step is {step!r}: give the sampling time in s, above 0.")

    # Parameters become numbers: generated code then folds constants, and cannot be misconfigured.
    source = given_model(thing, values, None, part)
    system, p = source.ode(pade)
    name = identifier(path.stem)
    formula, substeps = _discretized(system, p, step)
    method = "exact for this linear model"
    if substeps:
        method = f"{substeps} substeps of the classical Runge-Kutta method"

    texts = {"file": path.stem, "name": name, "upper": name.upper(), "step": step, "method": method}
    write_text(path.with_suffix(".h"), _header(source, system, p, texts))
    write_text(path, _source(system, p, formula, max(substeps, 1), path.stem, name))
    return path, path.with_suffix(".h")


def _discretized(system: Dynamics, p: Array, step: float) -> tuple[ca.Function, int]:
    """Return (x, u) -> x one substep later and the number of substeps, 0 where it is exact."""
    n, m = len(system.states), len(system.inputs)
    x, u, _ = system.symbols
    z = ca.vertcat(x, u)
    f = system.derivative(x, u, p)
    linearized = ca.Function("linearized", [z], [f, ca.jacobian(f, z)])
    at_zero, jacobian = map(np.asarray, linearized(np.zeros(n + m)))

    # A sign or a limiter is linear for CasADi, whose derivatives are constant.
    if ca.is_linear(f, z) and not has_switches(f):
        # What the derivative is at rest acts like one more held input, of one.
        exact = np.hstack(
            held_response(jacobian[:, :n], np.hstack([jacobian[:, n:], at_zero]), step)
        )
        return ca.Function("step", [x, u], [ca.DM(exact) @ ca.vertcat(z, 1)]), 0

    fastest = np.abs(np.linalg.eigvals(jacobian[:, :n])).max(initial=0.0)
    if not fastest * step <= 1000:
        raise ValueError(
            f"step is {step:g} s, and the fastest mode of the model decays within "
            f"{1 / fastest:.2g} s: give a shorter step, or a model without that mode."
        )

    # Half the stability limit of the method: away from rest modes may be faster than at rest.
    substeps = max(math.ceil(2 * step * fastest / RungeKutta.reach), 1)
    held = ca.SX.zeros(m)
    later = RungeKutta().advance(system, x, u, held, p, step / substeps)
    return ca.Function("step", [x, u], [later]), substeps


def _header(source: GivenModel, system: Dynamics, p: Array, texts: Mapping[str, Any]) -> str:
    numbers = ", ".join(
        f"{parameter} = {value:.6g}"
        for parameter, value in zip(system.parameters, p.tolist(), strict=True)
    )
    fitted = f", fitted to {source.name}" if source.name else ""
    title = f"{source.model.label}{fitted}, written by greybox."
    kinds = {"state": system.states, "input": system.inputs, "output": system.outputs}
    indices = []
    for kind, names in kinds.items():
        places = [
            f"{texts['upper']}_{kind.upper()}_{plain} = {i}"
            for i, plain in enumerate(identifiers(names).values())
        ]
        indices += [f"enum {{ {', '.join(places)} }};"] if places else []

    return HEADER.format(
        **texts,
        title=_comment(title),
        about=_comment(numbers or "It has no parameters."),
        n=len(system.states),
        m=len(system.inputs),
        k=len(system.outputs),
        indices="\n".join(indices) + "\n",
    )


def _comment(text: str) -> str:
    """Return a text that does not end the comment in which it stands."""
    # Names come from files of strangers: one with */ would put its rest into the source as code.
    return printable(text).replace("*/", "* /").replace("/*", "/ *")


def _source(
    system: Dynamics, p: Array, step: ca.Function, substeps: int, file: str, name: str
) -> str:
    x, u, _ = system.symbols
    formulas = {
        "derivative": ("dx", system.derivative(x, u, p)),
        "output": ("y", system.output(x, u, p)),
        "step": ("x", step(x, u)),
    }
    # CasADi's calling convention, with work arrays, stays inside the file: users call the wrappers.
    generator = ca.CodeGenerator(f"{name}_formulas", {"with_header": False})
    wrappers = []
    for what, (result, formula) in formulas.items():
        function = ca.Function(f"{name}_formula_{what}", [x, u], [formula])
        generator.add(function)
        arguments = "const double *x, const double *u, double *" + result
        sizes = (function.sz_arg(), function.sz_res(), function.sz_iw(), function.sz_w())
        wrapper = WRAPPER.format(
            *(max(size, 1) for size in sizes),
            name=f"{name}_{what}",
            arguments=arguments if what != "step" else "double *x, const double *u",
            count=substeps if what == "step" else 1,
            function=function.name(),
            result=result,
        )
        wrappers.append(wrapper)

    return "\n".join([f'#include "{file}.h"\n', generator.dump(), *wrappers])
