"""Images and figures: of a dataset (`look.py`), of predictions (`predict.py`, TensorBoard, the report), and of frames."""
