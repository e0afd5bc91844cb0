"""Is what an object.toml declares of its mesh so, and is it all that there is?"""
