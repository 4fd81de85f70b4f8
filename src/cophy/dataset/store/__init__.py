"""What is on disk for a dataset: sets of HDF5 shards, each a pure function of a configuration.

hdf5_arrays: fields of a shard, and how they are written to a file and read from one safely.
manifest: manifest.json, which vouches for the shards of a finished set.
shardset: `ShardSet`, what all sets have in common: opening, reading, checking and creating arrays.
experiment_set: `ExperimentSet`, experiments that were generated here or that others released; `FrameSource`, their pictures.
experiment_arrays: which arrays a shard of states has, of which shape and type.
states: `States`, the simulated experiments of a generated dataset.
forecasts: `OracleForecasts`, what the oracles say of the test experiments.
"""
