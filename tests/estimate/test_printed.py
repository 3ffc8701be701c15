"""Printed answers are those of tests/golden/answers.txt, which tests/support/printed_answers.py renews."""

from printed_answers import GOLDEN, differences, printed


def test_answers_are_printed_as_before():
    found = [*differences(GOLDEN.read_text(encoding="utf-8"), printed())]
    assert not found, "renew it if this is meant:\n" + "\n".join(found)


def test_words_and_numbers_are_compared_but_not_the_last_digit():
    assert not [*differences("a = 2.77 ± 0.49 of 1.00e-3", "a  = 2.78 ± 0.48 of 1.01e-3")]
    assert [*differences("a = 2.77", "a = 2.79")]
    assert [*differences("a = 2.77", "b = 2.77")]
    assert [*differences("a", "a\nb")]
