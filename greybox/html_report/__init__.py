"""A page about fits: one HTML file to look at and to hand on. Begin with `report`.

`page` puts it together, with `page.css` and the script `page.js` that draws the figures; `elements`
are what it is made of. An `entry` is one result. `fit_section` is what it shows of one fit:
`tables`, `interval_section`, `equation` with `mathml`, `provenance`, and the figures:
`response_figures`, `sensitivity_figure`, `history_figures`, `residual_figures`, `spectrum_figures`,
`starts_figure`, which are `figure`. `comparison_section` puts several results side by side.
"""

from greybox.html_report.report import report as report
