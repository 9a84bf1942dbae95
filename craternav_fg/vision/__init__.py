"""Rims and the sun's tilt from images."""
