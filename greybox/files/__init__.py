"""Text tables, safe and sealed files, JSON numbers and progress bars for all other folders.

Begin with `text_table`.

| file | contents |
| --- | --- |
| `normalization` | fields of a frozen value in their final form |
| `arrays` | types of numpy arrays for annotations; whether they are finite, parts, lengths |
| `text_table` | tables and numbers as people read them, also in notebooks |
| `delimited_text` | tables of numbers in files: separator, decimal mark, units, comments, facts |
| `grouping` | items in groups that are alike |
| `json_numbers` | values in JSON, without NaN and infinity, and bounded when they are read |
| `packed` | compressed bytes |
| `progress` | progress bars |
| `escapes` | texts of strangers in terminals, tables, LaTeX, pages and messages |
| `error_place` | an error as a sentence, with its place in a file of the user |
| `optional_package` | imports of optional packages |
| `rebuilt` | values that are pickled as the arguments of their construction |
| `safe_files` | atomic writes, and clear errors of reading |
| `sealed_files` | HDF5 files of one text with a checksum |
| `version` | the version of greybox |
| `subprocess_reader` | runs `subprocess_main`, which reads HDF5, MATLAB and PX4 files |
"""
