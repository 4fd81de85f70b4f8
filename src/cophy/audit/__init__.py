"""Audit of datasets: checks that generated or released data are balanced, physical and free of bias (`audit.py`)."""
