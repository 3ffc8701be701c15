"""What is drawn: in figures as values and in matplotlib axes.

It also has the settings of the fits that are drawn.
"""

QUICK = {"starts": 8, "progress": False}
TRUTH = {"a1": -14.61, "a2": 2.97, "a3": 8.47, "a4": 295.5, "T_delay": 0.04}


def named(panel, name, kind):
    """The only series of a panel whose name begins so."""
    (found,) = [s for s in panel.series if s.name.startswith(name) and s.kind == kind]
    return found


def points(axes):
    return [
        line
        for line in axes.get_lines()
        if line.get_linestyle() == "None" and line.get_label()[0] != "_"
    ]


def curves(axes):
    return [
        line
        for line in axes.get_lines()
        if line.get_linestyle() != "None" and line.get_label()[0] != "_"
    ]


def numbers(axes):
    return [text.get_text() for text in axes.texts]


def legend(axes):
    return [text.get_text() for text in axes.figure.legends[0].get_texts()]
