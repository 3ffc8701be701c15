"""What researchers do with fits: from a log to a model, to the next test, to many fits.

| folder | contents |
| --- | --- |
| `experiment/` | test signals, controllers, virtual flights, margins and gains, planning |
| `identification/` | from a log to a response and a model in one call |
| `study/` | batches of fits and the bootstrap, stored while they run |
"""
