"""Counterfactual learning of physical dynamics (CoPhy, ICLR 2020).

Rooms, each importing only those before it:

scenario: scenes, confounders, do-operations, simulation with PyBullet, and the search for experiments.
dataset: shards on disk, generation in parallel, released datasets, audits, and what models are fed.
models: what a model may see in, what it says about D out: CoPhyNet, its ablations, the baselines.
drawing: pictures for people.
training: Lightning modules, losses, metrics, runs and what comes out of them.
report: outputs/ -> the paper's tables, ours beside the paper's numbers.
app: the edge to Hydra; the commands (src/*.py), tests and benchmarks import it, nothing else does.

Files that all rooms may import:

types: what passes between data, models and losses: `Inputs`, `Targets`, `Batch`, `Prediction`.
errors: the error whose message is meant for the person at the terminal.
atomic_files: files that are there whole or not at all.
bootstrap: means over experiments, and their intervals.
"""

__version__ = "0.1.0"
