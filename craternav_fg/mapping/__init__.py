"""Crater catalogues made better: rims measured where the terrain shows them."""
