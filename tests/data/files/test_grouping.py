"""Items in groups that are alike."""

from greybox.data.files.grouping import grouped


def test_groups_and_their_items_keep_their_order():
    assert grouped("banana", str) == [["b"], ["a", "a", "a"], ["n", "n"]]
    assert grouped([3, -3, 2], abs) == [[3, -3], [2]]
    assert grouped([], abs) == []
