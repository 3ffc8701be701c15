"""Sentences of answers, whose long lines are folded."""


def unfolded(text):
    """Return the text of an answer with one blank in place of each line end and indentation."""
    return " ".join(str(text).split())
