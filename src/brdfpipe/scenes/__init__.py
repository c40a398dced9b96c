"""Scenes: the directions that a use of a BRDF needs, and the error that matters to it."""
