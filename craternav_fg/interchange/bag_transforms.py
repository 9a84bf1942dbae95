"""Static transforms of a bag: the pose of one frame in another."""

import numpy as np

from craternav_fg import frames
from craternav_fg.errors import InputError
from craternav_fg.interchange.bag_reading import TRANSFORMS, Bag, pose_of
from factors.arrays import FloatArray

_TOPIC = "/tf_static"
# Poses by two ways that differ by more contradict each other, rad and m: far above the rounding of floats.
_SAME = 1e-4


class StaticTransforms:
    """The static transforms of a bag.

    Parameters
    ----------
    bag : Bag

    Raises
    ------
    InputError
        When one is no pose.
    """

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._steps: dict[str, dict[str, FloatArray]] = {}
        for message in bag.messages(_TOPIC) if _TOPIC in bag.connected(TRANSFORMS) else ():
            for one in message.transforms:
                first, second = _frame(one.header.frame_id), _frame(one.child_frame_id)
                where = f"{_TOPIC}, {first} to {second}"
                T = pose_of(bag, where, one.transform.translation, one.transform.rotation)
                self._steps.setdefault(first, {})[second] = T
                self._steps.setdefault(second, {})[first] = frames.inverse(T)

    def pose(self, parent: str, child: str) -> FloatArray | None:
        """Look up the pose of one frame in another.

        Returns
        -------
        ndarray, shape (4, 4), or None
            Of the child in the parent, m; None when no static transforms lead from one to the other.

        Raises
        ------
        InputError
            When two ways from one to the other contradict each other.
        """
        return self._poses(parent).get(_frame(child))

    def related(self, name: str) -> str:
        """List the frames that static transforms relate to one, for messages."""
        return ", ".join(sorted(set(self._poses(name)) - {_frame(name)})) or "no frame"

    def _poses(self, parent: str) -> dict[str, FloatArray]:
        """Poses in a frame of all frames that are related to it."""
        poses, left = {_frame(parent): np.eye(4)}, [_frame(parent)]
        while left:
            first = left.pop()
            for second, T in self._steps.get(first, {}).items():
                pose = poses[first] @ T
                if second not in poses:
                    poses[second] = pose
                    left.append(second)
                elif not np.allclose(poses[second], pose, rtol=0.0, atol=_SAME):
                    raise InputError(
                        self._bag.path,
                        f"{_TOPIC}: expected one pose of {second} in {_frame(parent)},"
                        f" found another by way of {first}: give --camera",
                    )
        return poses


def _frame(name: str) -> str:
    """Name of a frame; older writers begin it with a slash."""
    return str(name).removeprefix("/")
