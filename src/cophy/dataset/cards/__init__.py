"""What a dataset says of itself, to people and to programs.

dataset_card: README.md of a dataset: what it is, whether it is sound, how to load it.
picture_card: README.md of a folder of pictures.
field_table: arrays, their shapes, units and meanings, as a table.
croissant: croissant.json, the same as metadata that search engines and loaders read.
"""
