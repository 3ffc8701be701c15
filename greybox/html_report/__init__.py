"""A page about fits: one HTML file to look at and to share. Begin with `report`.

| file | contents |
| --- | --- |
| `report` | which results are on the page |
| `page` | puts the page together, with `page.css` and the script `page.js` that draws the figures |
| `entry` | one result |
| `fit_section` | everything about one fit |
| `comparison_section` | several results side by side; a study in a few figures |
| `formula` | the formulas in the description of a model |
| `figure` | the figures of `greybox.plotting` as elements of the page |
| `tables` | tables of estimates |
| `provenance` | where data and result come from |
| `elements` | HTML elements |
"""

from greybox.html_report.report import report as report
