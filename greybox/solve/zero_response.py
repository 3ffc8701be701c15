"""A wall around a response of zero, where searches with a wrong phase end.

Most criteria have a finite cost there: over the measured magnitude, (4.26) is the number of points.
If the phase of the model is wrong, a smaller gain lowers the cost. At a gain of zero no other
parameter changes it, so a search that arrives there cannot leave: for (2.7) on the pitch rate, in a
box of up to 1e6 for the gain, all of 200 searches end there. With the wall they find the phase
first, and 199 of them end at the minimum.
"""

from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.response_part import SMOOTHING, ResponsePart
from greybox.compiled.response_programs import CostProgram


def walled(problem: CompiledProblem) -> CostProgram:
    """Return the first, explicit program of a problem with a wall around zero responses.

    The wall is a logarithmic barrier of the mean square of the relative response; it vanishes at
    the smoothing of the last level.
    """
    program: Any = problem.programs[0].explicit
    z, smoothing, data = program.sx_in()
    cost, limits = program(z, smoothing, data)
    # Height of the wall at the first level of a search, as a share of the cost of a zero response.
    # The square root of the smoothing takes it down by ten from level to level. In the box above,
    # 99.9 % of 1024 searches for (2.7) end at the minimum with 0.5, 93 % with 1 and 71 % with 0.2;
    # in its declared box 86 % do if it falls with the root, and half of them if it falls with the
    # smoothing.
    share = 0.5 * ca.sqrt(ca.fmax(smoothing - SMOOTHING, 0))
    for part, height in zip(problem.parts_of(ResponsePart), problem.zero_costs, strict=True):
        relative = part.scaled_response(z) / np.tile(part.magnitude, 2)
        square = ca.sumsqr(relative) / len(part.magnitude)
        # At the last level a response may vanish, and its logarithm must still be finite.
        cost -= share * float(height) * ca.log(square + 1e-30)

    function = ca.Function("walled", [z, smoothing, data], [cost, limits])
    return CostProgram(function, explicit=function)
