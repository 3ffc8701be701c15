"""The options of `greybox fit` that state a problem."""

import argparse
from typing import Any

from greybox.cli.measurement_options import stated_band
from greybox.engine.compiled.compiled_problem import AnyProblem
from greybox.workflows.study.stated_problem import CRITERIA_BY_NAME, METHODS, stated_problem

PROBLEM_OPTIONS = f"""
problem [PROBLEM]
    an included problem, or my.py, or my.py:name
--model MODEL
    instead of PROBLEM: tilt:Tilt, 'polynomial:Polynomial(4, 1)' or my.py:Class
--data FILE...
    with --model: a frequency response (columns omega_rad_s, alpha, beta [, coherence, variance,
    dof]), or a record (columns time and, in SI units, the inputs and outputs of the model; without
    a time, rows for a static model);
    several are fitted together; for a flight log write a problem file
--through FILTER...
    with --model: filters between the output and its log: 'filters:LowPass(20, 0.71)', or by their
    names in the response, gyro-filter, gyro-notch ...
--input NAME
    input of a frequency response, if the model or the file has several
--output NAME
    output of a frequency response, if the model or the file has several
--at NAME=VALUE...
    with --model: operating point at which an ODE is linearized
--columns NAME=COLUMN[:UNIT]...
    with --data: the columns of a table with other names. For a response frequency=f:Hz
    magnitude=mag:dB phase=ph:deg coherence=coh, or alpha and beta; for a record time=t:ms and the
    signals of the model, theta=pitch:deg; for files of unlike headers, the names that a column has
    in them: theta=pitch:deg,Theta:rad
--rate
--gaps
--band FREQUENCY...
    lowest and highest frequency of the responses to fit, in rad/s or followed by Hz (default: all
    points)
--fix
--free
--bounds
--start
--starts-box NAME=LOW:HIGH...
    range of drawn starts, in place of the bounds
--prior NAME=VALUE+-SIGMA...
    normal prior with its standard deviation; the criterion must be a likelihood
--delay DELAY
    exact or pade:n (default: the problem's)
--criterion CRITERION
    {", ".join(CRITERIA_BY_NAME)} (default: the problem's)
--method {{{",".join(METHODS)}}}
    how records are transcribed and solved (default: the problem's)
"""


def problem_of(options: argparse.Namespace) -> tuple[AnyProblem, dict[str, Any]]:
    """Return the problem that the options state, and its settings."""
    return stated_problem(vars(options) | {"band": stated_band(options.band)})
