"""Matrix products on one thread: several threads wait for each other and gain nothing here.

With two threads, a record of 6000 samples takes twice the processor time on an idle machine, and
six times beside another program, and is not ready sooner.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController

_libraries = cache(ThreadpoolController)  # finding them takes 5 ms


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Leave matrix products to one thread until the end."""
    # It brings a library of its own, which a fit loads anyway: later, it would keep its threads.
    import scipy.linalg  # noqa: F401, PLC0415

    with _libraries().limit(limits=1, user_api="blas"):
        yield
