"""The description of a model on the page: formulas are images, what cannot be set stays text."""

from greybox.reporting.html_report.elements import description, html


def page(text):
    return "".join(map(html, description(text)))


def test_formulas_are_images_with_their_source_for_those_who_cannot_see_them():
    text = page(r"From `u`, $\tau$ is a lag:" + "\n\n" + r"$$\frac{K}{\tau s + 1}$$")
    assert text.startswith("<p>From u, <img src=")
    assert text.count('src="data:image/svg+xml;base64,') == 2
    assert r'alt="\frac{K}{\tau s + 1}" class="display"' in text


def test_what_matplotlib_cannot_set_and_markup_stay_text():
    text = page(r"$$\begin{bmatrix} 1 \end{bmatrix}$$ and <script>alert(1)</script>")
    assert r"<code>\begin{bmatrix} 1 \end{bmatrix}</code>" in text
    assert "<script>" not in text


def test_arguments_of_a_class_are_no_part_of_its_equation():
    sections = "Parameters\n----------\nn : int\n    Order.\n\nNotes\n-----\nStable."
    text = page(f"A lag.\n\n{sections}\n\nRaises\n------\nValueError\n    If not.")
    assert text == "<p>A lag.</p><p>Notes\n-----\nStable.</p>"
