"""The dataset card: a page for people, headed by YAML for Hugging Face, its figures measured."""

import json
from importlib import resources
from string import Template

from symsol_annot import __version__
from symsol_annot.publish.about import LICENCE, LICENCE_URL, About
from symsol_annot.publish.citation import bibtex
from symsol_annot.publish.croissant import GROUPS_NAME
from symsol_annot.publish.figures import Figures, SplitFigures
from symsol_annot.publish.sets import GROUPS_CONFIG, PublishedSet
from symsol_annot.sets.stated.equality import PartsOfSet
from symsol_annot.sets.statistics import sizes_in_words
from symsol_annot.system.text.markdown import escaped, fenced

CARD_NAMES = ("README.md", "dataset_card.md")  # Hugging Face reads the first; the same page under a name that says it
_DECADES = ("1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B", "100B", "1T")


def card(about: About, sets: tuple[PublishedSet, ...], figures: Figures) -> str:
    """Return the card of a bundle.

    Args:
        about: what the publisher says.
        sets: what is in the bundle, at least one.
        figures: of each split of each set.
    """
    template = resources.files("symsol_annot.publish").joinpath("card.md").read_text(encoding="utf-8")
    pairs = [(one, split) for one in sets for split in reversed(one.splits)]
    annotated = [(one, split) for one, split in pairs if one.manifest.is_annotated(split)]
    first, split = (annotated or pairs)[0]
    page = Template(template).substitute(
        title=escaped(about.title),
        software=__version__,
        licence=LICENCE,
        licence_url=LICENCE_URL,
        first=first.name,
        split=split,
        depth=_depth_in_words(sets),
        ids=_ids_in_words(sets),
        parts=_parts_in_words(sets),
        **_code_of_sets(first.name, is_annotated=bool(annotated)),
        contents=_contents(sets, figures),
        measured=_measured(sets, figures),
        barely=_barely_in_words(figures),
        tolerance=_tolerance_in_words(figures),
        bibtex=fenced(bibtex(about), "bibtex"),
    )
    return f"---\n{_front_matter(about, sets, figures)}---\n\n{page}"


def _code_of_sets(name: str, *, is_annotated: bool) -> dict[str, str]:
    """Return what the card's examples have on symmetry sets: nothing where no split has any."""
    groups = 'load_dataset(bundle, "symmetry_groups", split="train")'
    group = f'np.array(next(row["symmetry_group"] for row in groups if row["set"] == "{name}"))'
    code = {
        "load_group": f"\ngroups = {groups}\ngroup = {group}  # (G, 3, 3)",
        "make_set": '\nsymmetry_set = rotation @ group[np.array(sample["symmetry_mask"])]  # (k, 3, 3)',
        "read_set": ", sample.symmetry_set",
    }
    return code if is_annotated else dict.fromkeys(code, "")


def _front_matter(about: About, sets: tuple[PublishedSet, ...], figures: Figures) -> str:
    """Return the YAML that Hugging Face reads: JSON's way of quoting is YAML's, too."""
    images = sum(found.statistics.images for found in figures.values())
    fields = {
        "pretty_name": about.title,
        "license": LICENCE.lower(),
        "annotations_creators": ["machine-generated"],
        "size_categories": [_size_category(images)],
        "source_datasets": ["original"],
        "task_categories": ["other"],
        "tags": ["pose-estimation", "orientation-estimation", "symmetry", "so3", "synthetic"],
    }
    lines = [f"{name}: {json.dumps(value, ensure_ascii=False)}" for name, value in fields.items()]
    lines.append("configs:")
    for published in sets:
        lines += [f"- config_name: {json.dumps(published.name)}", "  data_files:"]
        for split in published.splits:
            lines += [f"  - split: {split}", f"    path: parquet/{published.name}/{split}-*.parquet"]
    lines += [f"- config_name: {GROUPS_CONFIG}", "  data_files:", "  - split: train", f"    path: {GROUPS_NAME}"]
    return "\n".join(lines) + "\n"


def _size_category(images: int) -> str:
    """Return Hugging Face's name for a count: a decade, like 10K<n<100K."""
    decade = len(str(images)) - 3  # 0 below 1,000
    if decade <= 0:
        return f"n<{_DECADES[0]}"
    return f"{_DECADES[decade - 1]}<n<{_DECADES[decade]}" if decade < len(_DECADES) else f"n>{_DECADES[-1]}"


def _contents(sets: tuple[PublishedSet, ...], figures: Figures) -> str:
    rows = [
        "| set | split | images | pixels | distance | focal_px | group order | T in pixels | shards | Parquet |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for published in sets:
        camera, tolerance = published.manifest.rendered.camera, published.manifest.rendered.tolerance_px
        for split in published.splits:
            found = figures[published.name, split]
            cells = [
                published.name,
                split,
                f"{found.statistics.images:,}",
                f"{camera.width}x{camera.height}",
                f"{camera.distance:g}",
                f"{camera.focal_px:.3f}",
                "all of SO(3)" if published.has_all_rotations else str(found.group_order),
                "no marking" if tolerance is None else f"{tolerance:g}",
                _megabytes(found.shard_bytes),
                _megabytes(found.parquet_bytes),
            ]
            rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def _measured(sets: tuple[PublishedSet, ...], figures: Figures) -> str:
    rows = [
        "| set | split | marking shows | barely | sizes of the symmetry sets | candidates | by the tolerance |",
        "|---|---|---|---|---|---|---|",
    ]
    for published in sets:
        for split in published.splits:
            cells = " | ".join(_cells(figures[published.name, split]))
            rows.append(f"| {published.name} | {split} | {cells} |")
    return "\n".join(rows)


def _cells(found: SplitFigures) -> list[str]:
    counted = found.statistics
    sizes = sizes_in_words(counted.set_sizes, counted.measures) if counted.is_annotated else "no symmetry sets"
    if not counted.has_marking:
        return ["", "", sizes, "", ""]
    shown = f"{counted.shown:,} ({100 * counted.shown / counted.images:.1f}%)"
    if found.barely is None:
        return [shown, "", sizes, "", ""]
    return [
        shown,
        f"{found.barely:,}",
        sizes,
        f"{counted.candidates_drawn:,}",
        f"{counted.candidates_within_tolerance:,}",
    ]


def _named(sets: tuple[PublishedSet, ...]) -> list[tuple[str, PartsOfSet]]:
    """Return the sets whose objects have parts by name, and these parts."""
    return [(one.name, parts) for one in sets if (parts := one.manifest.settings.named_parts)]


def _ids_in_words(sets: tuple[PublishedSet, ...]) -> str:
    """Say which ids segmentations have: those of objects with parts are named one by one."""
    named, plain = _named(sets), "1 body, 2 marking"
    rows = [
        f"of {name} " + ", ".join(f"{number} {part}" for number, part in enumerate(parts.names, start=1))
        for name, parts in named
    ]
    return "; ".join([*([plain] if len(named) < len(sets) else []), *rows])


def _parts_in_words(sets: tuple[PublishedSet, ...]) -> str:
    """Say which rule the sets of objects with parts follow; nothing where there are none."""
    named = _named(sets)
    if not named:
        return ""
    whose = "; ".join(
        f"{name}: {', '.join(parts.names[part - 1] for part in parts.breaking) or 'none'}" for name, parts in named
    )
    return (
        f"\n- Of {', '.join(name for name, _ in named)}, images are compared part by part instead: the set has the "
        "candidates whose images differ by less than T in the parts that break the symmetry, and those that move each "
        f"part onto itself. These parts are, of {whose}. `marking_pixels` is the area of the one that shows most."
    )


def _depth_in_words(sets: tuple[PublishedSet, ...]) -> str:
    """Say which sets have depth maps, and where."""
    having = [one.name for one in sets if one.manifest.settings.has_depth]
    if not having:
        return "No set has depth maps."
    return (
        f"Depth maps (`depth`, 32-bit floats) of {', '.join(having)} are in the shards alone: no image format that "
        "readers of Parquet show holds them to the bit."
    )


def _barely_in_words(figures: Figures) -> str:
    """Say how many images show hardly anything of a marking, over all splits where that was counted."""
    counted = [found for found in figures.values() if found.barely is not None]
    if not counted:
        return ""
    barely, images = sum(found.barely or 0 for found in counted), sum(found.statistics.images for found in counted)
    return f"Here it shows, but by less than 20 pixels, in {barely:,} of {images:,} annotated images of marked objects."


def _tolerance_in_words(figures: Figures) -> str:
    """Say how often the tolerance decided, over all splits where it could."""
    counted = [found.statistics for found in figures.values() if found.barely is not None]
    drawn = sum(statistics.candidates_drawn for statistics in counted)
    if not drawn:
        return ""
    within = sum(statistics.candidates_within_tolerance for statistics in counted)
    return f"Here T decided {within:,} of {drawn:,} candidates."


def _megabytes(size: int | None) -> str:
    return "not measured" if size is None else f"{size / 1e6:.1f} MB"
