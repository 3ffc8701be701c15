"""What a worker does: it builds the solver that it receives, and runs it from some starts."""

import os
import signal
import threading
from functools import partial

import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.solve.blas_threads import one_blas_thread
from greybox.engine.solve.interruption import limited
from greybox.engine.solve.runs import Outcomes
from greybox.engine.solve.worker_payload import unpickled
from greybox.modeling.one_thread import Stored

# The C library of Linux keeps freed memory up to twice the size of the largest array that was
# freed so far, if that has at most 32 MiB, and returns the rest to the system. To ask for it again
# at each evaluation makes one of 15 starts of 30 responses 1.5 to 2 times as long, and a fit of
# 6000 samples 6 % longer. So an array of that size is freed first, which nothing fills.
np.empty(4_000_000)


# A solver takes longer to build than many of its runs. Four serve the members of a study in turn.
_solvers = Stored(4)


def run_starts(payload: bytes, starts: Array, coordinator: int, end: float) -> Outcomes:
    """Run the pickled solver `payload` from every row of `starts` (r, p).

    `coordinator` is the process that decides about Ctrl-C, `end` the time of day at which its
    search ends.
    """
    if os.getpid() != coordinator and threading.current_thread() is threading.main_thread():
        # A terminal sends Ctrl-C to the workers as well.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    with limited(end), one_blas_thread():
        solver = _solvers.result(payload, partial(unpickled, payload))
        size = solver.together
        batches = (starts[k : k + size] for k in range(0, len(starts), size))
        return [outcome for batch in batches for outcome in solver.outcomes(batch)]
