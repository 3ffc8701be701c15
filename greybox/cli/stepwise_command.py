"""The command `greybox stepwise`: terms of a model chosen from a list of candidates."""

import argparse

from greybox.assessment.printed import summary
from greybox.assessment.validation.stepwise import stepwise
from greybox.cli.output import Answer
from greybox.cli.problem_options import PROBLEM_OPTIONS, problem_of
from greybox.cli.saved_fits import require_fit_file, save_fit
from greybox.data.files.named_values import attributes

EXAMPLES = (
    "pitch_moment --candidates b_vv b_vtheta b_vtau b_vq b_thetatheta b_thetaq",
    "my.py --candidates k_v k_vv exponent=1 --out chosen.h5",
)
# The options that people use; the help shows the others below them.
USED = "--model --data --columns --candidates --fix --free --bounds --criterion --starts --out"
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = f"""
{PROBLEM_OPTIONS}
--candidates NAME[=VALUE]...
    parameters that may be left out, each with the value that removes its term, 0 unless stated
    (required)
--starts N
    number of starts of every structure, besides the previous estimate (default: 4)
--out FILE
    save the fit of the chosen structure to this HDF5 file
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """State the problem and choose among its terms."""
    require_fit_file(options.out, options.force)
    # A coefficient vanishes at zero; an exponent or a factor has another value without its term.
    candidates = {name: value or 0.0 for name, value in options.candidates.items()}
    problem, _ = problem_of(options)
    selection = stepwise(problem, candidates, starts=options.starts)
    notes = save_fit(selection.fit, options.out)
    answer = attributes(selection, "terms", "candidates", "verdict", "trials", "alike")
    answer["fit"] = summary(selection.fit)
    return answer, str(selection), "", str(selection.fit), *notes
