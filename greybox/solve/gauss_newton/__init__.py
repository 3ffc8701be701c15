"""The Gauss-Newton method for problems that have records."""
