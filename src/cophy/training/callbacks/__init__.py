"""What a training shows and says on its way, each a callback of Lightning.

prediction_figures: pictures of predictions for TensorBoard.
prediction_clip: AB, the true CD and the predicted CD of twins as a clip.
derendering_figures: pictures of what a de-renderer finds, likewise.
drawing_times: when figures are drawn, and where they go.
gradient_norm: how large gradients are, averaged over an epoch.
best_validation: the validation metrics of the best epoch.
best_checkpoint: the weights with the smallest validation MSE, also where a training was stopped and goes on.
stopwatch: how long a training took.
stopping: what happens when a training is stopped.
"""
