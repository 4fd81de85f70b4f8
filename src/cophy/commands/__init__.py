"""The commands: `python src/train.py`, or `cophy-train` after `pip install`; one file each."""
