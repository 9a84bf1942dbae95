"""Identification without a prior: which catalogue crater is each rim, and where it was seen from."""
