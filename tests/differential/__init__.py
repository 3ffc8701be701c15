"""Random cases of greybox against SciPy, and against greybox itself where the answer must not change.

    python tests/differential                        # new cases for a minute
    python tests/differential --seed 7 --seconds 600
    python tests/differential --only simulate --case 123456

One line is printed for each case that differs, with the options that repeat it; the exit status is
then 1. Nothing is printed for a case that agrees.

| file | what is in it |
| --- | --- |
| `models` | random plants: each formula once, read by greybox and by NumPy |
| `clocks` | when samples are taken and which rows are lost; how inputs move between them |
| `references` | trajectories by SciPy for many parameter vectors at once; least squares from the truth |
| `records` | families of records: simulations and fits against these references |
| `responses` | families of frequency responses |
| `relations` | families of pairs whose answers are equal, whatever the truth |
| `cases` | the list of all families, those with open differences, and how a case is run |
| `test_sample` | a fixed sample of cases for the test suite |

Only public names of greybox are used, and the references do not call it.
"""
