"""`python -m greybox` and the `greybox` command are the same."""

import sys

from greybox.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
