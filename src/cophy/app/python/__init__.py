"""What `import cophy` offers, without a command line.

loading: `cophy.load`, the data.
predictors: `cophy.load_predictor`, trained predictors.
"""
