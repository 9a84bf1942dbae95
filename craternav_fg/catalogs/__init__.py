"""Crater catalogues: the model with its spatial index, files of any origin, checks, elevation models."""
