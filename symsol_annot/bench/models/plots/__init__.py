"""Pictures of losses, trainings and classifiers."""
