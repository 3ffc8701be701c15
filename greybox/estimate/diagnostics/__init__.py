"""What a fit warns of: one question a file, each a sentence or none."""
