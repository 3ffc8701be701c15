"""The problem as functions of the solver's variables.

Begin with `compiled_problem`. A record is cut into segments (`sampled_data`), every sample is one CasADi function
(`sample_step`), `sensitivities` linearizes all segments at once and `condensing` eliminates their initial states, that
is, continuity. `transcription/` holds the alternatives, one method a file.
"""
