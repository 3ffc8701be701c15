"""Texts of strangers, as each destination shows them."""

import pytest

import greybox as gb
from greybox.data.files.escapes import (
    LONGEST_SENTENCE,
    csv_cell,
    in_sentences,
    latex_text,
    sentence,
    terminal_text,
)


def test_a_terminal_gets_no_control_character_but_lines_and_tabs():
    text = "a\x1b]0;title\x07\x9b31m\u202e\u2028\r\nb\tü θ"
    shown = terminal_text(text)
    assert shown == "a\\x1b]0;title\\x07\\x9b31m\\u202e\\u2028\\r\nb\tü θ"
    assert terminal_text(shown) == shown


@pytest.mark.parametrize(
    "text", ["=1+1", "+cmd|' /C calc'!A0", "-2+3", "@SUM(A1)", "\t=1", "\r=1", "=\x1b"]
)
def test_a_text_in_a_table_is_no_formula(text):
    cell = csv_cell(text)
    assert cell.startswith("'")
    assert cell.isprintable()


@pytest.mark.parametrize("value", [None, 1.5, -2, True, "-3.5", "+1e5", "a = 1", "θ", "1-2"])
def test_numbers_and_plain_texts_stay_as_they_are(value):
    assert csv_cell(value) == value


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\x0b", "\x0c", "\x85", "\u2028"])
def test_a_text_in_latex_stays_in_its_line_and_commands_nothing(end):
    shown = latex_text(f"Lag{end}\\input{{/etc/passwd}} % $x^2$")
    assert len(shown.splitlines()) == 1
    assert "\\input" not in shown
    assert shown.endswith(r"\textbackslash{}input\{/etc/passwd\} \% \$x\textasciicircum{}2\$")


def test_the_message_of_an_exception_is_printable_and_short():
    text = sentence("no column 'a\x1b[2J'; it has " + "b" * 100_000 + ": did you mean 'c'?")
    assert text.startswith("no column 'a\\x1b[2J'; it has bbb")
    assert text.endswith("did you mean 'c'?")
    assert len(text) <= LONGEST_SENTENCE + 5


def test_an_error_of_a_reader_keeps_its_type_and_its_causes_are_printable_too():
    class OwnError(ValueError):
        pass

    @in_sentences
    def read():
        try:
            raise KeyError("\x1b[2J")
        except KeyError as error:
            raise OwnError("\x1b[31m") from error

    with pytest.raises(OwnError, match=r"^\\x1b\[31m$") as caught:
        read()
    assert caught.value.__cause__.args == ("\\x1b[2J",)


@pytest.mark.parametrize("read", [gb.read, gb.read_response])
def test_a_header_is_quoted_without_its_control_characters(tmp_path, read):
    path = tmp_path / "a.csv"
    path.write_text("time\x1b[2J,\x1b]0;x\x07\n1,a\n2,b\n3,c\n")
    with pytest.raises(ValueError, match=r"a\.csv") as caught:
        read(path)
    assert str(caught.value).isprintable()


def test_a_long_header_makes_no_long_error(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"{'a' * 100_000},{'b' * 100_000}\n1,a\n2,b\n3,c\n")
    with pytest.raises(ValueError, match=r"a\.csv") as caught:
        gb.read_response(path)
    assert len(str(caught.value)) < 3000
