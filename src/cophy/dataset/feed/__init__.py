"""What models are fed: stored arrays as tensors, and the LightningDataModules over them.

batches: arrays of experiments to `Batch`: what models see, and the truth.
declared_inputs: which optional inputs the configuration of a model declares.
appearance_features: object types and poses as numbers per object.
confounder_features: the true confounders as numbers per object, standardised.
batch_order: which experiments or frames make up each batch, on each device.
counterfactual_dataset: one split of experiments, whole in memory.
counterfactual_datamodule: experiments for predictors of D.
frame_dataset: single frames, read when they are asked for.
frame_datamodule: frames for de-renderers.
"""
