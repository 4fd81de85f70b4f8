"""Datasets that others released, read where they lie: one module per format, one index over all.

protocol: `ReleasedFormat`, what a format has to tell.
formats/: the formats that are known.
recording: what the files of one experiment say, and whether it can be true.
untrusted_files: reading files of unknown origin without running or following anything.
released_spec: which experiments of a folder are meant, and as what they are read.
id_lists: lists of ids that say which experiments train, validate and test.
trust: which indexed experiments count, and what of them is believed.
released_states: `ReleasedStates`, the index: experiments gathered in one pass into shards.
clips: `Clips`, the pictures of released experiments.
export/: generated data in the format of CoPhy_224.
"""
