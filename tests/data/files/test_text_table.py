"""Tables of text."""

from greybox.data.files.text_table import text_table


def test_columns_are_aligned():
    assert text_table(["name", "value"], [["a", "1.5"], ["longer", "10"]]).splitlines() == [
        "name    value",
        "------  -----",
        "a         1.5",
        "longer     10",
    ]
