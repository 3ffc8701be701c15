"""Model structures, one family a file."""
