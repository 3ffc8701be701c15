"""Whether a model explains its data, and if not, what it may lack.

Begin with `assessment`. The residuals are regressed on what missing terms would add to the outputs;
no term needs another fit. What is tried is in `causes/`.

| file | contents |
| --- | --- |
| `answer` | the answer: `Misfit` with its causes and the shape of the best term |
| `term` | a term that a model may lack: its words, code and effect |
| `equations` | the equations of a record, which may lack terms |
| `signal_changes` | delays, rates, filters and followers of a signal |
| `tested_record` | a record as causes look at it |
| `causes/` | the causes, a file each |
| `shortened_record` | a long record with fewer samples |
| `regression` | a part as a regression of its residuals |
| `record_regression`, `response_regression`, `manoeuvre_regression` | how it is made of each kind |
| `group` | all records, or all responses, as one regression |
| `ranking` | the best term of every family |
| `functions` | functions of any shape in the place of a likely term |
| `response_tests` | the tests of responses, whose errors may be correlated |
| `shape` | how the best term depends on a signal |
| `group_misfit` | the misfit of a group |
| `assessment` | the test of a fit |
| `of_fit` | the same for a given fit, with terms and causes of your own |
"""
