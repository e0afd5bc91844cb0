"""Writing a gallery: a folder with a page, the page's scripts, pictures as PNG and data as scripts.

index.html, assets/             the page, plotly's bundle
data/index.js                   sets, their volumes, runs, and one column per filter
data/SHA256SUMS                 the other files, so that the next gallery replaces nothing but this one
sets/00-cylO-test/00003/        images 300 to 399: labels.js, one run-0.js per run, image-000300.png, ..
sets/00-cylO-test/redrawn.js    which candidates were drawn again; their pictures beside it
"""

import contextlib
import os
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from importlib import resources
from pathlib import Path

import numpy as np

from symsol_annot import __version__
from symsol_annot.bench.predictions.proposals import Predicted
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.errors import OutputError, first_of, output_errors
from symsol_annot.gallery.redrawn import Drawing, Redrawer
from symsol_annot.gallery.runs import Run
from symsol_annot.gallery.scripts import Document, number, packed, write_script
from symsol_annot.gallery.sources import Source
from symsol_annot.plotting.contact_sheet import ID_COLOURS
from symsol_annot.rotations.so3 import rotation_to_quat_wxyz
from symsol_annot.system.checksums import changed_in, is_system_note, names_in, read_list, to_list
from symsol_annot.system.files import replaced_folder
from symsol_annot.system.locks import held_folder
from symsol_annot.system.machine import check_extra
from symsol_annot.system.png import to_png
from symsol_annot.system.reading import file_sha256

CHUNK_IMAGES = 100  # whose labels the page loads at once
STRATUM_CODES = ("all", "hidden", "shown", "barely")  # "all" where there is no marking
_INDEX = Path("data", "index.js")
_INDEX_KEY = "index"
_LIST = Path("data", "SHA256SUMS")
_MADE_BY = "symsol-annot gallery"
_LISTED_NAMES = 5
_PLOTLY = "plotly.min.js"
_DOTS_OF_VOLUME = 500  # rotations that show a volume on the page
_DRAWS_NONE = partial(Redrawer, count=0)


def write_gallery(
    out: Path,
    sources: Sequence[Source],
    runs: Sequence[Run] = (),
    open_redrawer: Callable[[Source, Sequence[Run]], Redrawer] = _DRAWS_NONE,
    on_image: Callable[[], object] = lambda: None,
) -> None:
    """Write a gallery into a folder, whole or not at all.

    Args:
        out: the folder, or a link to it; a gallery in it is replaced once the new one is whole, anything else refused.
        sources: what it shows.
        runs: predictions over them.
        open_redrawer: from a source and its runs to what draws candidates again.
        on_image: called after each image.

    Raises:
        MissingExtraError: plotly, whose JavaScript the page draws with, is not installed.
        OutputError: the folder holds something else, cannot be written, or another process is writing there.
        DataError: an image cannot be read.
        RenderError: Blender stopped.
    """
    check_extra("gallery", "the gallery")
    out = Path(os.path.realpath(out))
    _notes_in(out)  # refuses another folder before anything is made
    with held_folder(out), replaced_folder(out) as new:
        redrawn = [
            _write_source(
                new, source, [(n, run) for n, run in enumerate(runs) if run.source == k], open_redrawer, on_image
            )
            for k, source in enumerate(sources)
        ]
        _write_page(new)
        (new / _INDEX).parent.mkdir()
        write_script(new / _INDEX, _INDEX_KEY, _index(sources, runs, redrawn))
        (new / _LIST).write_bytes(to_list({name: file_sha256(new / name) for name in names_in(new)}, _MADE_BY))
        for name in _notes_in(out):  # looked at again: it is about to be removed
            (new / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(out / name, new / name, follow_symlinks=False)


def _notes_in(out: Path) -> set[str]:
    """Return what the system keeps in a folder beside a gallery; refuse one that holds anything else.

    Raises:
        OutputError: the folder is to be removed, and holds what this program did not make, or what was changed since.
    """
    with output_errors(out):
        if not out.exists():
            return set()
        there = names_in(out)
        notes = {name for name in there if is_system_note(name)}
        listed = read_list(out / _LIST, _MADE_BY)
        own = set() if listed is None else {*listed, _LIST.as_posix()}
        _refuse(out, there - notes - own, "holds what is no part of a gallery")
        _refuse(
            out, changed_in(out, listed or {}), "holds files of a gallery that were changed since they were written"
        )
        return notes


def _refuse(out: Path, names: set[str], what: str) -> None:
    if names:
        raise OutputError(
            f"{out}: {what}: {first_of(sorted(names), _LISTED_NAMES)}. Nothing was touched; "
            "move it elsewhere, or choose another folder with --out"
        )


def _write_page(folder: Path) -> None:
    assets = folder / "assets"
    assets.mkdir()
    for file in (resources.files("symsol_annot.gallery") / "page").iterdir():
        place = folder if file.name == "index.html" else assets
        (place / file.name).write_bytes(file.read_bytes())
    bundle = resources.files("plotly") / "package_data" / _PLOTLY
    (assets / _PLOTLY).write_bytes(bundle.read_bytes())


def _index(sources: Sequence[Source], runs: Sequence[Run], redrawn: Sequence[Document]) -> Document:
    return {
        "version": __version__,
        "chunk_images": CHUNK_IMAGES,
        "strata": list(STRATUM_CODES),
        "sets": [_describe(source, about) for source, about in zip(sources, redrawn, strict=True)],
        "runs": [_describe_run(run, sources[run.source]) for run in runs],
    }


def _describe(source: Source, redrawn: Document) -> Document:
    truth, shown = source.truth, len(source.dataset)
    width, height = source.dataset.image_size
    codes = np.zeros(len(truth), dtype=np.uint8)
    for code, stratum in enumerate(STRATUM_CODES):
        if stratum in truth.strata:
            codes[truth.strata[stratum]] = code
    if not truth.has_marking:
        codes[:] = 0
    return {
        "object": truth.object,
        "split": truth.split,
        "folder": source.folder,
        "place": str(source.dataset.folder),
        "fingerprint": truth.fingerprint,
        "images": shown,
        "images_of_split": len(truth),
        "width": width,
        "height": height,
        "has_segmentation": bool(source.dataset.parts),
        "parts": list(source.dataset.parts),
        "part_colours": [
            f"#{r:02x}{g:02x}{b:02x}" for r, g, b in ID_COLOURS[1 : len(source.dataset.parts) + 1].tolist()
        ],
        "group_order": len(truth.labels.symmetry_group),
        "group": packed(rotation_to_quat_wxyz(truth.labels.symmetry_group), "f4"),
        "stratum": packed(codes[:shown], "u1"),
        "set_size": packed(truth.set_sizes[:shown], "u4"),
        **_volumes(source, shown),
        **_parts_in_view(source, shown),
        "marking_px": packed(truth.labels.marking_pixels[:shown], "f4"),
        "redrawn": redrawn,
    }


def _volumes(source: Source, shown: int) -> Document:
    """Return the volumes that sets fill, each once, by its share of SO(3) and dots in it, and which each image has."""
    labels = source.truth.labels
    if labels.volume is None:
        return {"volumes": [], "volume": None}
    volumes = [
        {
            "share": number(volume.measure),
            "quat_wxyz": packed(rotation_to_quat_wxyz(volume.sample(_DOTS_OF_VOLUME, np.random.default_rng(0))), "f4"),
        }
        for volume in labels.volumes
    ]
    return {"volumes": volumes, "volume": packed(labels.volume[:shown], "i2")}


def _parts_in_view(source: Source, shown: int) -> Document:
    """Return which parts break the symmetry, and for each image whether it shows each of all parts; else nothing."""
    parts, areas_px = source.dataset.manifest.settings.named_parts, source.truth.labels.part_pixels
    if parts is None or areas_px is None:
        return {"breaking": [], "in_view": None}
    shows = areas_px[:shown] >= (parts.tolerance_px or np.finfo(np.float32).tiny)
    return {"breaking": [number - 1 for number in parts.breaking], "in_view": packed(shows, "u1")}


def _describe_run(run: Run, source: Source) -> Document:
    shown = len(source.dataset)
    metrics = [
        {
            "name": metric.name,
            "title": metric.title,
            "better": metric.better,
            "values": packed(metric.values[:shown], "f4"),
            "means": {stratum: number(value) for stratum, value in metric.means.items()},
        }
        for metric in run.metrics
    ]
    return {
        "set": run.source,
        "method": run.method,
        "track": run.track,
        "name": run.name,
        "drawn": TRACKS[run.track].title,
        "warnings": list(run.warnings),
        "metrics": metrics,
    }


def _write_source(
    gallery: Path,
    source: Source,
    runs: Sequence[tuple[int, Run]],
    open_redrawer: Callable[[Source, Sequence[Run]], Redrawer],
    on_image: Callable[[], object],
) -> Document:
    """Write what belongs to one source; return which of its images were drawn again."""
    folder = gallery / source.folder
    folder.mkdir(parents=True)
    drawings: dict[int, list[Document]] = {}
    with contextlib.closing(open_redrawer(source, [run for _, run in runs])) as redrawer, source.dataset as dataset:
        for start in range(0, len(dataset), CHUNK_IMAGES):
            chunk = folder / f"{start // CHUNK_IMAGES:05d}"
            chunk.mkdir()
            rows = range(start, min(start + CHUNK_IMAGES, len(dataset)))
            write_script(chunk / "labels.js", f"{source.folder}/{chunk.name}/labels", _labels(source, rows))
            for n, run in runs:
                document = _predicted([run.predicted[i] for i in rows])
                write_script(chunk / f"run-{n}.js", f"{source.folder}/{chunk.name}/run-{n}", document)
            for i in rows:
                sample = dataset[i]
                (chunk / f"image-{i:06d}.png").write_bytes(to_png(sample.image))
                if sample.segmentation is not None:
                    ids = to_png(sample.segmentation, ID_COLOURS[: max(3, len(source.dataset.parts) + 1)])
                    (chunk / f"segmentation-{i:06d}.png").write_bytes(ids)
                found = redrawer.draw(sample)
                if found:
                    drawings[i] = [_write_drawing(folder, i, drawing) for drawing in found]
                on_image()
    if drawings:
        write_script(folder / "redrawn.js", f"{source.folder}/redrawn", {str(i): d for i, d in drawings.items()})
    return {"images": sorted(drawings), "missing": redrawer.missing}


def _labels(source: Source, rows: range) -> Document:
    labels, part = source.truth.labels, slice(rows.start, rows.stop)
    return {
        "quat_wxyz": packed(rotation_to_quat_wxyz(labels.rotation[part]), "f4"),
        "mask": packed(np.packbits(labels.symmetry_mask[part], axis=1, bitorder="little"), "u1"),
    }


def _predicted(predicted: Sequence[Predicted]) -> Document:
    quat_wxyz = rotation_to_quat_wxyz(np.concatenate([one.rotations for one in predicted]))
    return {
        "offsets": packed(np.cumsum([0, *(len(one.weights) for one in predicted)]), "u4"),
        "quat_wxyz": packed(np.rint(32767 * quat_wxyz), "i2"),
        "weights": packed(np.rint(255 * np.concatenate([one.weights for one in predicted])), "u1"),
        "left_out": [one.left_out for one in predicted],
    }


def _write_drawing(folder: Path, image: int, drawing: Drawing) -> Document:
    file = f"redrawn/{image:06d}-{drawing.element:04d}.png"
    (folder / file).parent.mkdir(exist_ok=True)
    (folder / file).write_bytes(to_png(drawing.image))
    return {
        "file": file,
        "element": drawing.element,
        "is_member": drawing.is_member,
        "angle_deg": round(drawing.angle_deg, 2),
        "differing_px": drawing.differing_px,
    }
