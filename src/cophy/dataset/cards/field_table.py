"""Arrays of a shard as a table for people."""

import numpy as np
from tabulate import tabulate

from cophy.dataset.store.hdf5_arrays import Field, Fields


def field_table(fields: Fields) -> str:
    """Markdown: name, type, shape of one experiment, unit and meaning of every array."""
    rows = [(f"`{name}`", *_said(field)) for name, field in fields.items()]
    return tabulate(rows, ("array", "type", "axes", "unit", "meaning"), tablefmt="pipe", disable_numparse=True)


def _said(field: Field) -> tuple[str, ...]:
    sizes = ", ".join(map(str, field.shape[1:]))
    axes = f"{field.axes} (…, {sizes})" if sizes else field.axes
    return np.dtype(field.dtype).name, axes, field.unit, field.meaning
