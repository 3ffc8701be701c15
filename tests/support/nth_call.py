"""Something that happens at the n-th call of a function of Python: no clock decides when."""

import sys
from contextlib import contextmanager


@contextmanager
def at_call(number, action):
    """Do the action at the call of this number, counted from here; yields the list of one count."""
    count = [0]

    def see(_, event, __):
        if event == "call":
            count[0] += 1
            if count[0] == number:
                action()

    before = sys.getprofile()
    sys.setprofile(see)
    try:
        yield count
    finally:
        sys.setprofile(before)
