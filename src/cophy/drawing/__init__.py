"""Pictures for people, of experiments and of predictions: used by look.py, predict.py, TensorBoard and the report.

labels: words, and text as pictures.
sheets: frames in rows and columns, with words beside them; depth and segmentation in colours.
picture_files: frames that people bring are read, pictures are written.
gifs: clips as animated GIFs, markers in frames.
plots: trajectories, centres and error over time as figures.
close_up: frames of a dataset, whole and cropped to what moves.
overview: what look.py shows of a dataset, and of one experiment.
twins: both twins of a pair, one above the other.
modalities: RGB, depth and segmentation of a frame, with their scales.
counterfactual_files: what predict.py writes.
"""
