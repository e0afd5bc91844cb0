"""How far a surface lies from itself when it is turned: exactly at points, and bounded triangle by triangle."""
