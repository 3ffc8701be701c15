"""The command line: one file per command. Begin with `main`, which declares the commands.

| file | contents |
| --- | --- |
| `main` | the commands, and the parser of their options |
| `execution` | runs a command; errors become sentences |
| `list_command`, `new_command` | models and problems: included ones, new ones |
| `inspect_command`, `response_command`, `identify_command` | logs |
| `orders_command`, `identifiability_command` | structures |
| `fit_command`, `profile_command`, `bootstrap_command` | fits and their errors |
| `stepwise_command`, `compare_command`, `report_command` | several fits |
| `predict_command`, `simulate_command` | a fit on another log |
| `export_command` | a fit for other programs |
| `margins_command`, `tune_command` | the loop of a fit and a controller, and safe gains |
| `batch_command` | studies |
| `options` | how options are stated and read; those that several commands share |
| `workers` | where runs are made |
| `output` | what a command gives: answer, exit status, files, figures |
| `problem_options` | the options of `greybox fit` that state a problem |
| `read_log`, `measurement_options` | a log, and how its tests are measured |
| `saved_fits` | reads and writes results |
| `study_file`, `study_copies` | the members of a batch; the files that they are made of |
| `starting_files` | what `greybox new` writes |
| `terminal` | standard output that is closed or on a full disk |
"""
