"""One run: what train.py does once. The configuration is taken apart in `cophy.app.assembly`.

identity: the names of a run, its place among the others, and what makes two configurations the same run.
claim: one process at a time makes a run, and no run replaces another's results.
results: the files it leaves: metrics, predictions, or a note that it failed.
stages: what a run trains and tests: a de-renderer or a predictor.
oracle: the run of an oracle, which trains nothing.
devices: runs on several devices, a process for each.
execution: train (or adopt), test, write the results.
trainer: Lightning's Trainer as every run uses it.
reuse: finding a training that was the same, so that it is not done again.
"""
