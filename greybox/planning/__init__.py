"""Planning a flight test: what a test would tell, and which test tells most for its time.

Begin with `expected_errors`, the standard errors that a planned test would give, for any problem with its data from a
virtual flight. `sine_plan` chooses the frequencies, amplitudes and durations of sines that reach wanted errors in the
shortest flight; the shares of time are an `optimal_design`, the amplitudes follow from the `closed_loop`.
`chosen_tests` says which of several tests to fly and how often: axes, operating points, kinds of excitation.
"""

from greybox.planning.chosen_tests import ChosenTests as ChosenTests
from greybox.planning.chosen_tests import choose_tests as choose_tests
from greybox.planning.expected_errors import ExpectedErrors as ExpectedErrors
from greybox.planning.expected_errors import expected_errors as expected_errors
from greybox.planning.sine_plan import SinePlan as SinePlan
from greybox.planning.sine_plan import plan_sines as plan_sines
