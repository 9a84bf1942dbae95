"""`python -m craternav_fg` is the command line."""

from craternav_fg.cli import main

if __name__ == "__main__":
    main()
