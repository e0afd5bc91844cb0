"""Which sets a folder holds."""

from pathlib import Path

from symsol_annot.errors import DataError
from symsol_annot.sets.manifest import MANIFEST_NAME
from symsol_annot.system.text.names import SPLITS

_SHARDS = tuple(f"{split}-?????-of-?????.h5" for split in SPLITS)


def set_folders(folder: Path) -> list[Path]:
    """Return the folder itself where it is a set, else the sets in it, by name; none where there are none.

    A folder with shards that has lost its manifest counts, so that it is missed rather than passed over. Hidden ones
    do not.

    Raises:
        DataError: the folder cannot be read.
    """
    try:
        if (folder / MANIFEST_NAME).exists():
            return [folder]
        return sorted({path.parent for name in (MANIFEST_NAME, *_SHARDS) for path in folder.glob(f"[!.]*/{name}")})
    except OSError as error:
        raise DataError(f"{folder}: cannot be read: {error.strerror}") from None
