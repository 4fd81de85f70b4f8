"""What comes out of training, and how it is used again.

checkpoints: what train.py saves, read without running code from it.
plain_values: what a checkpoint says of itself holds nothing else.
resuming: whether a training may go on from a checkpoint.
network: a network from the name of its class and its arguments, and from those and its weights.
trained_derenderer: positions and presence from pictures; finding the de-renderer that a run needs.
derendering: what a trained de-renderer sees in a dataset, kept beside it.
trained_predictor: the network of a checkpoint and the scenario it knows.
counterfactual_prediction: from the pictures of AB and C to D (paper Fig. 2).
"""
