"""How predictions are judged.

metrics: measures of one experiment: MSE, final positions, pixels, stability.
validation_counts: what validation counts beside: errors by cell, towers that stand or fall.
twin_metrics: measures of twins: does a prediction tell them apart as the truth does?
evaluation: every measure of every test experiment.
copies: what the copies score on the same test split.
gathering: what the devices of a run measured, brought together.
probe: what U says about mass and friction (paper Table 5).
"""
