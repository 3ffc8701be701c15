"""Names and counts as words of a sentence."""

import math

from greybox.data.files.numbers_in_text import number
from greybox.data.files.wording import counted, listed, some


def test_words_and_numbers():
    assert [counted(1, "record"), counted(2, "record")] == ["1 record", "2 records"]
    assert counted(2, "axis", "axes") == "2 axes"
    assert [number(1.23456789), number(math.nan), number(2.0, 3)] == ["1.2346", "-", "2"]


def test_names_are_listed_as_in_a_sentence():
    assert [listed(["a", "b", "c"][:k]) for k in (1, 2, 3)] == ["a", "a and b", "a, b and c"]


def test_of_many_names_the_first_are_given_and_how_many_more_there_are():
    assert some(list("abcd")) == "a, b, c and d"
    assert some(list("abcde")) == "a, b, c, d and e"  # which is no longer than "1 more"
    assert some(list("abcdef")) == "a, b, c, d and 2 more"
    assert some(list("abcdef"), 2) == "a, b and 4 more"


def test_counts_may_be_numbers_of_any_kind():
    assert [counted(1.0, "s"), counted(0, "row"), counted(1e6, "row"), counted(10**6, "row")] == [
        "1 s", "0 rows", "1e+06 rows", "1000000 rows",
    ]  # fmt: skip
