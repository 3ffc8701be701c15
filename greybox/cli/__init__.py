"""The command line: `main`, one file a command; `catalog` finds models and problems."""
