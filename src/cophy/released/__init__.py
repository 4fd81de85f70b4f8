"""Datasets that others released, read as if they were generated here, and exports in their format."""
