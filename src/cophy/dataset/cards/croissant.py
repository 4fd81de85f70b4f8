"""croissant.json: metadata of a dataset in MLCommons' format (http://mlcommons.org/croissant/1.0)."""

import json
from pathlib import Path
from typing import Any

from cophy.dataset.spec import DatasetSpec
from cophy.dataset.store.hdf5_arrays import Field, Fields
from cophy.dataset.store.manifest import read_checksums

CROISSANT = "croissant.json"
# what the words of the file stand for; the format asks every file to carry this
CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "citeAs": "cr:citeAs",
    "conformsTo": "dct:conformsTo",
    "recordSet": "cr:recordSet",
    "field": "cr:field",
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "source": "cr:source",
    "fileSet": "cr:fileSet",
    "extract": "cr:extract",
    "column": "cr:column",
    "includes": "cr:includes",
    "isArray": "cr:isArray",
    "arrayShape": "cr:arrayShape",
}
SHARDS = {
    "@type": "cr:FileSet",
    "@id": "shards",
    "name": "shards",
    "encodingFormat": "application/x-hdf5",
    "includes": "shard-*.h5",
}
PAPER = "F. Baradel, N. Neverova, J. Mille, G. Mori, C. Wolf: CoPhy: Counterfactual Learning of Physical Dynamics, ICLR 2020"
TYPES = {"f": "sc:Float", "b": "sc:Boolean", "u": "sc:Integer", "i": "sc:Integer"}  # by letter of NumPy's type


def croissant(spec: DatasetSpec, directory: Path, fields: Fields) -> str:
    """The metadata as JSON.

    Args:
        spec: Of the dataset.
        directory: Of the dataset, which is finished.
        fields: Arrays of its shards.
    """
    names = [f"shard-{shard:05d}.h5" for shard in range(spec.num_shards)]
    checksums = read_checksums(directory, names) or {}
    metadata = {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": f"cophy-{spec.scenario.name}-{spec.id}",
        "description": f"{spec.num_experiments} counterfactual experiments of {spec.scenario.name} with {spec.num_objects} objects, "
        "in pairs of twins that differ in their confounders alone",
        "license": "https://www.apache.org/licenses/LICENSE-2.0",
        "citeAs": PAPER,
        "version": f"{spec.generating_configuration()['format']}.0.0",
        "distribution": [*(_file(name, checksum) for name, checksum in checksums.items()), SHARDS],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "experiments",
                "name": "experiments",
                "field": [_field(name, field) for name, field in fields.items()],
            }
        ],
    }
    return json.dumps(metadata, indent=2) + "\n"


def _file(name: str, checksum: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "encodingFormat": "application/x-hdf5",
        "sha256": checksum,
    }


def _field(name: str, field: Field) -> dict[str, Any]:
    unit = f" ({field.unit})" if field.unit else ""
    array = {"isArray": True, "arrayShape": ",".join(map(str, field.shape[1:]))} if field.shape[1:] else {}
    return {
        "@type": "cr:Field",
        "@id": f"experiments/{name}",
        "name": name,
        "description": f"{field.axes}: {field.meaning}{unit}",
        "dataType": TYPES[field.dtype[1]],
        "source": {"fileSet": {"@id": SHARDS["@id"]}, "extract": {"column": name}},
        **array,
    }
