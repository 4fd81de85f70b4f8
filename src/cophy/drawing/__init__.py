"""Pictures for people, of experiments and of predictions: used by look.py, predict.py, TensorBoard and the report.

sheets: frames in rows and columns, titled; depth and segmentation in colours.
picture_files: frames that people bring are read, pictures are written.
gifs: clips as animated GIFs, markers in frames.
plots: trajectories, centres and error over time as figures.
overview: what look.py shows of a dataset.
counterfactual_files: what predict.py writes.
"""
