"""Which scene and image of a BOP dataset an image of a split is: scenes of 1,000 images, one object after the other."""

from symsol_annot.errors import DataError

SCENE_IMAGES = 1000
FIRST_SCENE = 1
MAX_SCENE_ID = 999_999  # of six digits


def scene_and_image(first_scene: int, index: int) -> tuple[int, int]:
    """Return the scene id and the image id, within the scene, of image `index` of an object's split.

    Args:
        first_scene: the id of the object's first scene.
        index: of the image within the split.
    """
    scene, im_id = divmod(index, SCENE_IMAGES)
    return first_scene + scene, im_id


def index_of(first_scene: int, scene_id: int, im_id: int) -> int:
    """Return the index within the split that `scene_and_image` gave these ids for.

    Raises:
        DataError: it gives them for none.
    """
    if not first_scene <= scene_id <= MAX_SCENE_ID:
        raise DataError(f"scene_id {scene_id}: the object's scenes begin with {first_scene}, as --first-scene says")
    if not 0 <= im_id < SCENE_IMAGES:
        raise DataError(f"im_id {im_id}: a scene has images 0 to {SCENE_IMAGES - 1}, as export-bop numbers them")
    return (scene_id - first_scene) * SCENE_IMAGES + im_id


def scenes_of(images: int) -> int:
    """Return how many scenes an object of so many images has."""
    return -(-images // SCENE_IMAGES)
