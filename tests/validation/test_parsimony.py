"""Which structure the data support, and the one sentence that says so."""

import pytest

from greybox.validation.nested_models import NestedTest
from greybox.validation.parsimony import parsimony, smallest_supported
from greybox.validation.significance import Evidence

ABC = ("a", "b", "c")


def nested(p, small, large):
    return Evidence(0, "", NestedTest(small, large, ("x",), 1.0, 1.0, 1.0, (1, 9.0), p))


@pytest.mark.parametrize(
    ("bic", "sizes", "chosen"),
    [
        ((10.0, 12.0, 30.0), (3, 2, 1), 1),  # two above the least is as good
        ((10.0, 12.01, 30.0), (3, 2, 1), 0),
        ((-30.0, -31.0, -29.5), (2, 2, 2), 1),  # of one size the least
    ],
)
def test_the_smallest_within_two_of_the_least_is_supported(bic, sizes, chosen):
    assert smallest_supported(bic, sizes) == chosen


@pytest.mark.parametrize(
    ("bic", "sizes", "tests", "said"),
    [
        ((10.0, 14.567, 30.0), (1, 2, 3), {}, "a (1 free) is supported: it has the least BIC, by 4.57."),
        ((10.0,), (1,), {}, "a (1 free) is supported: it has the least BIC."),
        (
            (11.234, 10.0, 30.0), (1, 2, 3), {},
            "a (1 free) is supported: it is the smallest whose BIC is within 2 of the least, that of b (1.2 less), "
            "which is not worth more than a bare mention.",
        ),
        ((10.0, 12.0, 30.0), (2, 2, 1), {}, "a and b (2 free) are supported alike: their BIC differs by at most 2."),
        (
            (10.0, 15.0, 30.0), (1, 2, 3), {(0, 1): nested(0.051, "a", "b")},
            "a (1 free) is supported: it has the least BIC, by 5, and no test finds that b explains more.",
        ),
        (
            (10.0, 15.0, 30.0), (1, 2, 3),
            {(0, 1): nested(0.2, "a", "b"), (0, 2): nested(0.3, "a", "c"), (1, 2): nested(0.01, "b", "c")},
            "a (1 free) is supported: it has the least BIC, by 5, and no test finds that b and c explain more.",
        ),
        (
            (10.0, 15.0, 30.0), (1, 2, 3), {(0, 1): nested(0.049, "a", "b"), (0, 2): nested(0.3, "a", "c")},
            "a (1 free) is supported: it has the least BIC, by 5; but tests find more in b (p = 0.049), so that it "
            "is a close call.",
        ),
        # Tests against smaller structures, and those of other kinds, say nothing of more.
        (
            (10.0, 15.0, 30.0), (2, 1, 3), {(0, 1): nested(0.01, "b", "a"), (0, 2): Evidence(1, "x")},
            "a (2 free) is supported: it has the least BIC, by 5.",
        ),
    ],
)  # fmt: skip
def test_the_sentence_says_why(bic, sizes, tests, said):
    assert parsimony(ABC[: len(bic)], bic, sizes, tests) == (0, said)
