"""The methods: for each kind of model its recipe, how it is trained, and how it predicts."""
