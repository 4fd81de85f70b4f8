"""The paper's tables, as far as runs fill them.

paper_tables: the tables of the paper (paper_tables.yaml).
filled_tables: a table of the paper with our numbers.
captions: what is said below it.
shares: shares of the possible gain, and how sure they are.
twin_table: what runs made of AB, without any oracle.
table_formats: filled tables as Markdown and LaTeX.
terminal_tables: tables on the terminal.
"""
