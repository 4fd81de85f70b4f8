"""Images and figures for `look.py`, `predict.py`, TensorBoard and the report."""
