"""Which catalogue crater is each rim."""
