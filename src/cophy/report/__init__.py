"""The paper's tables and figures, filled by the runs in outputs/ (report.py)."""
