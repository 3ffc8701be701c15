"""Many fits, kept in a folder as they are made.

Begin with `batch`, which makes them; `study` is what they have come to so far, also while they run.
`study_folder` says what is in the folder, `run_files` how the runs of one problem are kept.
`unfinished_fit` keeps those of a single fit. `bootstrap` repeats one fit on data that are drawn
anew (`response_replicates`, `record_replicates`), with the data left open in the compiled problem
(`open_data`); `resampling` has intervals from replicates, and blocks of a series.
"""

from greybox.study.batch import Member as Member
from greybox.study.batch import batch as batch
from greybox.study.bootstrap import Bootstrap as Bootstrap
from greybox.study.bootstrap import bootstrap as bootstrap
from greybox.study.study import Study as Study
from greybox.study.study import StudyMember as StudyMember
from greybox.study.study import read_study as read_study
