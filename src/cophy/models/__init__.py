"""Predictors: `Batch` in, `Prediction` out. They know no Lightning, no configuration and no files."""
