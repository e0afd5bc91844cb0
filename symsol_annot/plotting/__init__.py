"""Pictures of images and of rotations."""
