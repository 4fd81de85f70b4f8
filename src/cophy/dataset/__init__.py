"""Datasets: what they are called, how they are made and stored, and what a model is fed from them."""
