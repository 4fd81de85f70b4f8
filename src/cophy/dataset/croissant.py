"""Metadata of parquet files in MLCommons' format Croissant, which mlcroissant validates and reads."""

import json
from collections.abc import Mapping
from typing import Any

CROISSANT = "croissant.json"
NAMES = (  # of the format's vocabulary
    "citeAs column containedIn extract field fileObject fileProperty fileSet format includes isArray arrayShape jsonPath key md5 "
    "parentField path recordSet references regex repeated replace samplingRate separator source subField transform "
    "equivalentProperty isLiveDataset"
)
CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{name: f"cr:{name}" for name in NAMES.split()},
}
PARQUET = "application/x-parquet"
PAPER = "F. Baradel, N. Neverova, J. Mille, G. Mori, C. Wolf: CoPhy: Counterfactual Learning of Physical Dynamics, ICLR 2020"
TYPES = {"f": "sc:Float", "b": "sc:Boolean", "u": "sc:Integer", "i": "sc:Integer"}  # by first letter of NumPy's type


def croissant(datasets: Mapping[str, dict[str, Any]]) -> str:
    """Return the metadata of exported datasets as JSON: a set of records for each, without images.

    Args:
        datasets: Manifests of the datasets, by the name of their folder.
    """
    distribution: list[dict[str, Any]] = []
    for name, dataset in datasets.items():
        files = [
            {
                "@type": "cr:FileObject",
                "@id": f"{name}/{file}",
                "name": f"{name}/{file}",
                "contentUrl": f"{name}/{file}",
                "encodingFormat": PARQUET,
                "sha256": checksum,
            }
            for file, checksum in dataset["files"].items()
        ]
        contained = [{"@id": file["@id"]} for file in files]
        files_of = {"@type": "cr:FileSet", "@id": f"{name}-files", "name": f"{name}-files", "containedIn": contained}
        distribution += [*files, {**files_of, "encodingFormat": PARQUET, "includes": f"{name}/*.parquet"}]
    ids = ", ".join(dataset["id"] for dataset in datasets.values())
    metadata = {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": "cophy",
        "description": f"Counterfactual experiments in pairs of twins that differ in their confounders alone: {ids}",
        "license": "https://www.apache.org/licenses/LICENSE-2.0",
        "citeAs": PAPER,
        "version": f"{next(iter(datasets.values()))['configuration']['format']}.0.0",
        "distribution": distribution,
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": name,
                "name": name,
                "field": [
                    _field(name, array, description)
                    for array, description in dataset["arrays"].items()
                    if description["dtype"] != "image"
                ],
            }
            for name, dataset in datasets.items()
        ],
    }
    return json.dumps(metadata, indent=2) + "\n"


def _field(dataset: str, name: str, description: Mapping[str, Any]) -> dict[str, Any]:
    unit = f" ({description['unit']})" if description["unit"] else ""
    shape = ",".join(map(str, description["shape"]))
    array = {"isArray": True, "arrayShape": shape} if shape else {}
    return {
        "@type": "cr:Field",
        "@id": f"{dataset}/{name}",
        "name": name,
        "description": f"{description['axes']}: {description['meaning']}{unit}",
        "dataType": TYPES[description["dtype"][0]],
        "source": {"fileSet": {"@id": f"{dataset}-files"}, "extract": {"column": name}},
        **array,
    }
