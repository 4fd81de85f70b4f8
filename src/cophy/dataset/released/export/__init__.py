"""Generated data in the format of CoPhy_224, for code that was written for it.

exporter: a dataset and its pictures to a folder; goes on where it was stopped.
experiment_files: the files of one experiment.
exported_lists: the lists of ids that split the experiments.
"""
