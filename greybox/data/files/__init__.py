"""Text tables, safe and sealed files, JSON numbers and progress bars for all other folders.

Begin with `arrays` and `argument_checks`, which nearly all other files use.

| file | contents |
| --- | --- |
| `normalization` | fields of a frozen value in their final form |
| `arrays` | types of numpy arrays for annotations; whether they are finite, parts, lengths |
| `named_values` | values by name: some of them, and their places in arrays |
| `frozen_values` | frozen dataclasses that hold arrays |
| `grouping` | items in groups that are alike, and every item once |
| `argument_checks` | checks of arguments, with what to give instead |
| `public` | short signatures, and the closest name for an unknown argument |
| `spelling` | the known name that a misspelled one resembles |
| `numbers_in_text` | rounded numbers as people read them, with errors, in percent |
| `wording` | names and counts as words of a sentence |
| `greek_letters` | Greek letters for the names of parameters and signals |
| `text_table` | tables in a terminal |
| `folded_text` | long lines of answers, folded at blanks |
| `printed` | values that print themselves, also in notebooks |
| `control_characters` | control characters in names and texts, written out |
| `escapes` | texts of strangers in terminals, tables, LaTeX, pages and messages |
| `delimited_text` | tables of numbers in files: separator, header, comments, facts |
| `decimal_marks` | numbers in cells, with decimal points or commas |
| `json_numbers` | values in JSON, without NaN and infinity |
| `bounded_json` | values of JSON, bounded when they are read |
| `packed` | compressed bytes |
| `progress` | progress bars |
| `error_place` | an error as a sentence, with its place in a file of the user |
| `optional_package` | imports of optional packages |
| `rebuilt` | values that are pickled as the arguments of their construction |
| `safe_files` | atomic writes, and clear errors of reading |
| `sealed_files` | HDF5 files of one text with a checksum |
| `version` | the version of greybox |
| `subprocess_reader` | runs `subprocess_main`, which reads HDF5, MATLAB and PX4 files |
"""
