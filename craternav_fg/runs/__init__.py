"""Runs on disk: the folder of a reconstruction, written and read back."""
