"""How networks are trained and judged, and what comes out.

prediction_module: stage 2 under Lightning, a predictor of D; sums up the losses.
derendering_module: stage 1 under Lightning, a de-renderer.
losses: the terms of the training loss (paper Sec. 4.2).
augmentation: training experiments, turned, mirrored and seen less exactly.
optimisation: the optimiser, and its learning rate over time.
settings: the key `training` of the configuration.
model_contract: what a network has to return.
curves: how TensorBoard names runs and values.
callbacks/: what a training shows and says on its way.
measures/: how predictions are judged.
runs/: one run, from data and network to its results.
trained/: checkpoints, and what is done with them.
"""
