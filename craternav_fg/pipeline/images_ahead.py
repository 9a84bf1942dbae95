"""Images of a data set, each read while the one before it is measured."""

from concurrent.futures import Future, ThreadPoolExecutor

from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray


class ImagesAhead:
    """Reads the image after the one that is asked for, in a thread: decoding needs no Python.

    Parameters
    ----------
    dataset : Dataset
    """

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self._thread = ThreadPoolExecutor(1)
        self._read: dict[int, Future[ImageArray]] = {}

    def image(self, frame: int) -> ImageArray:
        """Give the image of a frame, and begin to read the next one.

        Parameters
        ----------
        frame : int
            Index of the frame.

        Returns
        -------
        ndarray of uint8 or uint16, shape (height, width)
            Grey levels from 0 to the camera's full scale.

        Raises
        ------
        InputError
            When it is missing or damaged.
        """
        known = self._read
        if frame in known and known[frame].exception() is not None:
            # What failed may succeed when it is asked for.
            del known[frame]
        wanted = [k for k in (frame, frame + 1) if k < len(self._dataset)]
        self._read = {k: known.get(k) or self._thread.submit(self._dataset.image, k) for k in wanted}
        return self._read[frame].result()
