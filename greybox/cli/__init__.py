"""The command line. Begin with `main`: it declares the commands, calls one, and turns errors into sentences.

`list_command` is `greybox list`, `log_commands` are `greybox inspect` and `greybox response`; `greybox fit` stands in
`main`. `catalog` finds the models and problems that are included and those in a user's own file, `data_file` reads what
`--data` names, `command` holds what all commands return.
"""
