"""A page about fits: one HTML file to look at and to share. Begin with `report`.

| file | contents |
| --- | --- |
| `report` | the page, with `page.css` and the script `page.js` that draws the figures |
| `fit_section` | everything about one fit, and where it comes from |
| `loop_sections` | margins of loops; gains beside today's |
| `comparison_section` | several results side by side; a study in a few figures |
| `elements` | HTML elements: tables, formulas, the figures of `greybox.reporting.plotting` |
"""

from greybox.reporting.html_report.report import report as report
