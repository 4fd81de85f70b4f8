"""What report.py and audit.py say: ours beside the paper's numbers, and what a dataset is worth.

pipeline: from outputs/ to tables and figures, which report.py calls.
choices: what the names of a run stand for, as the report asks for it.
runs/: what was run.
tables/: the paper's tables, filled by runs.
people/: what people clicked in the human study.
colors: of figures.
figures: predictions, error over time, tables as bars.
stability_distribution: share of towers that stand, per value of the confounders.
mse_by_difficulty: on which experiments a model fails.
difficulty_page: the same as a page and figures.
audit_report: an audit in the terminal, as a page, and in the dataset's card, which audit.py calls.
audit_page: the page of an audit.
"""
