import pytest

from greybox.data.safe_files import replacing, write_text


def test_a_text_is_written_whole(tmp_path):
    path = tmp_path / "a.csv"
    write_text(path, "ω, °\n")
    assert path.read_bytes() == "ω, °\n".encode()
    write_text(path, "new")
    assert path.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


@pytest.mark.parametrize("before", ["old", None])
def test_a_failure_leaves_what_was_there_and_nothing_else(tmp_path, before):
    path = tmp_path / "a.csv"
    if before is not None:
        path.write_text(before)

    def fail(temporary):
        temporary.write_text("half of")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:
        fail(temporary)
    assert [p.read_text() for p in tmp_path.iterdir()] == ([] if before is None else [before])


def test_nobody_sees_a_file_that_is_not_complete(tmp_path):
    path = tmp_path / "a.csv"
    with replacing(path) as temporary:
        temporary.write_text("half of")
        assert not path.exists()
        assert temporary.parent == path.parent  # a rename is atomic only within a file system
    assert path.read_text() == "half of"
