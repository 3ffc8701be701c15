"""Many fits, kept in a folder as they are made, and the bootstrap of one fit.

Begin with `batch`.

| file | contents |
| --- | --- |
| `batch` | fit many problems; a batch that was killed resumes |
| `grid` | members for all combinations of models, data and settings |
| `stated_problem` | the problem that options describe by name |
| `catalog` | included models and problems, and those in a user's own file |
| `data_file` | a data file: a response, a spectrum or a record |
| `study` | members and answers of a study, also while it runs |
| `ranking` | which structure describes the data sets best |
| `latex` | tables for a paper |
| `members` | the members of a study on disk |
| `stored_runs` | the runs of a member, stored as they are made |
| `database` | the SQLite database of a study, opened safely |
| `damage` | what is damaged in it, or was not made by this user |
| `study_lock` | the lock of the process that writes |
| `answer` | what a study stores of a fit, checked when it is read |
| `ownership` | the mark of the user on stored runs and answers |
| `running` | whether a process is working on a study |
| `bootstrap` | repeat one fit on data that are drawn anew |
| `replicates` | data that are drawn anew, and their refits |
| `record_replicates`, `response_replicates` | those of records, and of responses |
"""

from greybox.workflows.study.batch import Member as Member, batch as batch
from greybox.workflows.study.bootstrap import Bootstrap as Bootstrap, bootstrap as bootstrap
from greybox.workflows.study.grid import grid as grid
from greybox.workflows.study.members import StudyMember as StudyMember
from greybox.workflows.study.study import Study as Study, read_study as read_study
