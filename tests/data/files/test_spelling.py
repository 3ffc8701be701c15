"""Misspelled names."""

from greybox.data.files.spelling import alternatives, nearest


def test_a_misspelled_name_is_recognized():
    known = ["roll", "Pitch", "yaw"]
    assert [nearest(name, known) for name in ("pich", "ROL", "thrust")] == ["Pitch", "roll", None]
    assert alternatives("yew", known) == "roll, Pitch, yaw: did you mean 'yaw'?"
    assert alternatives("thrust", known) == "roll, Pitch, yaw."
    assert alternatives("thrust", []) == "none."
