"""Networks: what a model may see (`Inputs`) in, what it says about D (`Prediction`) out.

They know no Lightning, no configuration and no files.

cophynet: CoPhyNet and its ablations (paper Sec. 4).
confounder_estimator: from AB to the estimate U of the confounders (Sec. 4.1).
appearance: object type and pose, for a model that declares them.
decoders: from C and U to D, with the stability gate (Sec. 4.2).
baselines: copy B, copy C, Interaction Network, Neural Physics Engine.
derenderer: from an image to positions and presence (appendix).
options: the values that switches in conf/model and conf/ablation can have.
alongside/: a predictor that reads AB step by step while it predicts D; not in the paper.
layers/: graph convolution (Eq. 1), packing of slots, MLPs.
"""
