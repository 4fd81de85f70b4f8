"""Datasets: which one is meant, how it is made and stored, whether it is sound, and how models are fed with it.

spec: `DatasetSpec`, the configuration that determines every byte of a generated dataset, and its name on disk.
splits: which experiments train, validate and test, and the parts of them that `split=` asks for.
source: from `source=`, `split=` and numbers of objects to sets of experiments, generated or released.
generation: shards made by worker processes; resumable, and the same bytes however it is run.
experiment_dataset: whole experiments as named tensors, for code of one's own.
replay: scenes and do-operations of stored experiments, to be looked at or simulated again.
state_features: what follows from stored states: outcomes, stable objects, visible axes.
stored_towers: stored towers as statics sees them.
difficulty: how hard each experiment is.
store/: what is on disk: states, forecasts of the oracles, and how shards are written and read.
pictures/: pictures of the states, all or those that are looked at, and what a de-renderer sees in them.
cards/: what a dataset says of itself, to people and to programs.
released/: datasets of others, read where they lie; and export in their format.
audit/: is a dataset what it claims to be?
feed/: what a model is fed.
"""
