"""Colours of the report's figures."""

GREY, BLUE, RED = "#b9bec6", "#2b6fd6", "#d1342f"
