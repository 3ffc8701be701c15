"""Text tables, safe and sealed files, JSON numbers, progress: what every other folder uses.

| file | contents |
| --- | --- |
| `arrays` | types of numpy arrays for annotations |
| `text_table` | tables and numbers as people read them |
| `delimited_text` | how a table of numbers was written: separator, decimal mark, comments |
| `heading` | name and unit of a column |
| `html_text` | the same tables for notebooks |
| `json_numbers` | numbers as JSON has them |
| `progress` | how far long work has come |
| `optional_package` | imports of packages that greybox works without |
| `safe_files` | atomic writes, and clear errors of reading |
| `sealed_files` | HDF5 files with a checksum |
| `subprocess_reader` | starts `subprocess_main`, the only place where an HDF5 file is read, in a process of its own |
"""
