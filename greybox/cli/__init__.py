"""The command line. Begin with `main`: it declares the commands, runs one, and turns errors into sentences.

Each command is a file: `fit_command`, `profile_command`, `bootstrap_command`,
`identifiability_command`, `reduce_command`, `stepwise_command`, `orders_command`, `list_command`,
`inspect_command`, `identify_command`, `response_command`, `plot_command`, `batch_command`,
`compare_command`, `report_command`, `new_command`, `completion_command`. `study_file` reads the
members of a batch, `starting_files` has what `greybox new` writes.

`stated_problem` makes the problem that the options of `greybox fit` state, `catalog` finds the
included models and problems and those in a user's own file, `parameter_options` says which
parameters are fixed and where the others may lie, `data_file` reads what `--data` names, `columns`
says what the columns of somebody's table are, and `log_tests` finds the test segments of a log,
`saved_fits` reads and writes results.

`options` holds what the options of all commands share, `workers` those for runs in other processes,
`output` what the commands give: answers, exit statuses, files and figures. `startup` takes care of
Ctrl-C during imports, `terminal` of colors, and of standard output that is not UTF-8, closed, or on
a full disk.
"""
