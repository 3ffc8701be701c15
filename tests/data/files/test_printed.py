"""How a value represents itself."""

from greybox.data.files.printed import one_line


def test_a_representation_is_one_short_line():
    assert one_line(1.0, "a", "b") == "<float a, b>"
    assert one_line(1.0, "two\nlines") == "<float two lines>"
    assert len(one_line(1.0, "long " * 100)) < 120
    assert one_line(1.0, "long " * 100).endswith("...>")


def test_the_longest_representation_is_119_characters():
    assert one_line(1.0, "x" * 111) == f"<float {'x' * 111}>"
    assert one_line(1.0, "x" * 112) == f"<float {'x' * 108}...>"
