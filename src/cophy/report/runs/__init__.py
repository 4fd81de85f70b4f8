"""What was run, as the files in outputs/ say.

run_table: outputs/ as a table with one line per run.
stored_run: the files of one run, read with care.
run_overview: what was run, before any number.
comparable: which of them may be averaged.
"""
