"""Training of the learned judgement of crater candidates, on rendered ground alone.

`python -m craternav_fg.training FOLDER` renders scenes, collects the detector's own candidates with what is
known of them, trains the network and writes its weights, `judge.npz`, into the folder. No photograph and no
annotation is trained on.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
