"""Which structure the data support, and the one sentence that says so."""

import pytest

from greybox.assessment.validation.nested_models import NestedTest
from greybox.assessment.validation.parsimony import parsimony

ABC = ("a", "b", "c")


def nested(p, small, large):
    return NestedTest(small, large, ("x",), 1.0, 1.0, 1.0, (1, 9.0), p)


@pytest.mark.parametrize(
    ("bic", "sizes", "chosen"),
    [
        ((10.0, 12.0, 30.0), (3, 2, 1), 1),  # two above the least is as good
        ((10.0, 12.01, 30.0), (3, 2, 1), 0),
        ((-30.0, -31.0, -29.5), (2, 2, 2), 1),  # of one size the least
    ],
)
def test_the_smallest_within_two_of_the_least_is_supported(bic, sizes, chosen):
    assert parsimony(ABC, bic, sizes)[0] == chosen


@pytest.mark.parametrize(
    ("bic", "sizes", "tests", "chosen", "words"),
    [
        ((10.0, 14.567, 30.0), (1, 2, 3), (), 0, "a (1 free) is supported: it has the least BIC, by 4.57."),
        ((10.0,), (1,), (), 0, "it has the least BIC."),
        ((11.2, 10.0, 30.0), (1, 2, 3), (), 0, "within 2 of the least, that of b."),
        ((10.0, 12.0, 30.0), (2, 2, 1), (), 0, "a and b (2 free) are supported alike"),
        ((10.0, 15.0, 30.0), (1, 2, 3), [nested(0.051, "a", "b")], 0, "by 5."),
        ((10.0, 15.0, 30.0), (1, 2, 3), [nested(0.049, "a", "b")], 0, "b (p = 0.049), so it is a close call."),
        ((10.0, 15.0, 30.0), (2, 1, 3), [nested(0.01, "b", "a")], 0, "by 5."),
    ],
)  # fmt: skip
def test_the_sentence_says_why(bic, sizes, tests, chosen, words):
    k, sentence = parsimony(ABC[: len(bic)], bic, sizes, tests)
    assert k == chosen
    assert sentence.endswith(words) or words in sentence
