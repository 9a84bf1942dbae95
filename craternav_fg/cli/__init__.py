"""The command line `craternav`: a module for each group of commands."""

from craternav_fg.cli.app import app, main

__all__ = ["app", "main"]
