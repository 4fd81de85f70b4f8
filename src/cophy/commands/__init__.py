"""The commands: `python src/train.py`, or `cophy-train` where the package was installed.

generate: makes the datasets that a split needs.
audit: proves them sound.
train: trains and tests one model on one split.
report: tables and figures of all runs.
derender: what a de-renderer sees in every frame.
look: pictures of a dataset.
predict: from pictures of AB and C to D.
study: the human study of Table 1.
export: generated data in the format of a released dataset.
"""
