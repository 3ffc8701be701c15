"""How a problem in time becomes one of optimization: one method a file, interchangeable on one problem."""
