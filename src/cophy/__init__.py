"""Counterfactual learning of physical dynamics (CoPhy, ICLR 2020).

Layers, each importing only those before it:

    scenario   scenes, confounders, do-operations, PyBullet, the search for experiments
    dataset    shards on disk, generation in parallel, released datasets, splits, what a model is fed
    models     tensors in, tensors out: CoPhyNet, its ablations, the baselines
    training   Lightning modules, losses, metrics
    report     outputs/ -> the paper's tables, ours beside the paper's numbers

`config` (typed configuration) and `cli` (errors in one line) tie them to Hydra.
"""

__version__ = "0.1.0"
