"""The paper's tables, as far as runs fill them.

run_table: outputs/ as a table with one line per run.
stored_run: the files of one run, read with care.
paper_tables: the tables of the paper (paper_tables.yaml).
filled_tables: a table of the paper with our numbers.
captions: what is said below it.
shares: how sure a share of the possible gain is.
twin_table: what runs made of AB, without any oracle.
table_formats: filled tables as Markdown, LaTeX and on the terminal.
"""
