"""Croissant 1.1: every file with its SHA-256, and every Parquet column with its type, as JSON-LD."""

import json
from typing import Any

from symsol_annot.publish.about import LICENCE_URL, About
from symsol_annot.publish.bundle import Bundle
from symsol_annot.publish.sets import GROUPS_CONFIG, PublishedSet

CROISSANT_NAME = "croissant.json"
GROUPS_NAME = f"parquet/{GROUPS_CONFIG}.parquet"
_PARQUET, _HDF5 = "application/x-parquet", "application/x-hdf5"
_CONTEXT: dict[str, Any] = {  # the standard one: mlcroissant warns where a name is missing, used or not
    "@language": "en",
    "@vocab": "https://schema.org/",
    "arrayShape": "cr:arrayShape",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"},
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isArray": "cr:isArray",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "name": {"@container": "@language"},
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
_SAMPLE_FIELDS: dict[str, tuple[str, str | None, str]] = {  # type, shape, description
    "index": ("cr:Int64", None, "Index of the image within its split."),
    "image": ("sc:ImageObject", None, "RGB, 8 bits."),
    "segmentation": ("sc:ImageObject", None, "Grey PNG of ids: 0 background, then the set's parts from 1 on."),
    "rotation": ("cr:Float64", "3,3", "R_m2c, model to camera: the rotation that the image was drawn at."),
    "symmetry_mask": ("sc:Boolean", "-1", "Which elements of the body's symmetry group are in the image's set."),
    "marking_pixels": ("cr:Float32", None, "The marking's visible area in pixels; 0 without a marking."),
    "marking_visible": ("sc:Boolean", None, "Whether that is at least the object's tolerance."),
    "part_pixels": ("cr:Float32", "-1", "The visible area in pixels of each of the set's parts; null where not known."),
}
_VOLUME_FIELD: dict[str, tuple[str, str | None, str]] = {  # of balls
    "volume": ("cr:Int32", None, "Which of the set's volumes belongs to the image's set besides; -1 for none."),
}
_FIELDS_OF_PARTS = {  # of sets whose objects have parts by name
    "marking_pixels": "The visible area in pixels of that part which shows most, of those that break the symmetry.",
    "marking_visible": "Whether that is at least the object's tolerance.",
}
_GROUP_FIELDS: dict[str, tuple[str, str | None, str]] = {
    "set": ("sc:Text", None, "The set's name."),
    "symmetry_group": ("cr:Float64", "-1,3,3", "The body's symmetries g: the image's set is R_m2c g, g in the mask."),
    "parts": ("sc:Text", "-1", "The names of the object's parts, in the order of their ids, the first of id 1."),
}


_VOLUMES_FIELD: dict[str, tuple[str, str | None, str]] = {
    "volumes": ("sc:Text", "-1", "Masks of cells of the equivolumetric grid of level 5, bits, as a zlib stream each."),
}


def croissant_json(
    about: About, description: str, bibtex: str, sets: tuple[PublishedSet, ...], bundle: Bundle
) -> bytes:
    """Return the metadata of a bundle whose shards and Parquet files are there."""
    distribution, record_sets = [_file(GROUPS_NAME, _PARQUET, bundle)], []
    for published in sets:
        for split in published.splits:
            entries = published.manifest.of_split(split)
            distribution += [_file(published.shard_name(entry), _HDF5, bundle) for entry in entries]
            distribution += [_file(published.parquet_name(entry), _PARQUET, bundle) for entry in entries]
            name = f"{published.name}_{split}"
            files = {
                "@type": "cr:FileSet",
                "@id": f"{name}_parquet",
                "name": f"{name}_parquet",
                "encodingFormat": _PARQUET,
                "includes": f"parquet/{published.name}/{split}-*.parquet",
            }
            distribution.append(files)
            source = {"fileSet": {"@id": files["@id"]}}
            record_sets.append(
                _record_set(name, f"The {split} images of {published.name}.", source, _fields_of(published))
            )
    source = {"fileObject": {"@id": GROUPS_NAME}}
    of_groups = {**_GROUP_FIELDS, **(_VOLUMES_FIELD if any(one.fills_volumes for one in sets) else {})}
    record_sets.append(
        _record_set(GROUPS_CONFIG, "The symmetry group of each set's body, and its parts.", source, of_groups)
    )
    document = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": about.title,
        "description": description,
        "license": LICENCE_URL,
        "version": about.version,
        **({"datePublished": about.date} if about.date else {}),
        **({"url": about.url} if about.url else {}),
        "creator": [{"@type": "sc:Organization", "name": author} for author in about.authors],
        "keywords": ["pose estimation", "orientation estimation", "symmetry", "SO(3)", "synthetic images"],
        "citeAs": bibtex,
        "isLiveDataset": False,
        "distribution": distribution,
        "recordSet": record_sets,
    }
    return (json.dumps(document, indent=1) + "\n").encode()


def _fields_of(published: PublishedSet) -> dict[str, tuple[str, str | None, str]]:
    """Return the columns of a set's images, described by the names of its parts."""
    settings = published.manifest.settings
    ids = ", ".join(f"{number} {name}" for number, name in enumerate(settings.parts, start=1))
    described = {"segmentation": f"Grey PNG of ids: 0 background, {ids}."}
    if settings.named_parts:
        described |= _FIELDS_OF_PARTS
    fields = {**_SAMPLE_FIELDS, **(_VOLUME_FIELD if published.fills_volumes else {})}
    return {column: (kind, shape, described.get(column, text)) for column, (kind, shape, text) in fields.items()}


def _file(name: str, encoding: str, bundle: Bundle) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "contentSize": f"{bundle.size(name)} B",
        "encodingFormat": encoding,
        "sha256": bundle.sha256(name),
    }


def _record_set(
    name: str, description: str, source: dict[str, Any], fields: dict[str, tuple[str, str | None, str]]
) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": description,
        "field": [_field(name, column, source, *about) for column, about in fields.items()],
    }


def _field(
    record_set: str, column: str, source: dict[str, Any], kind: str, shape: str | None, description: str
) -> dict[str, Any]:
    inside = {"transform": {"jsonPath": "bytes"}} if kind == "sc:ImageObject" else {}
    return {
        "@type": "cr:Field",
        "@id": f"{record_set}/{column}",
        "name": f"{record_set}/{column}",
        "description": description,
        "dataType": kind,
        **({"isArray": True, "arrayShape": shape} if shape else {}),
        "source": {**source, "extract": {"column": column}, **inside},
    }
