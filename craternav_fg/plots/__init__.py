"""Figures of runs, of images with their rims, and of catalogues."""
