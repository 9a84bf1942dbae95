"""Training of the crater network: it learns, goes on where it stopped, and its export runs in OpenCV."""

import cv2
import numpy as np
import pytest

from craternav_fg.errors import InputError
from craternav_fg.vision.pyramid import STRIDE_PX

torch = pytest.importorskip("torch", reason="needs the extra train")
pytest.importorskip("onnx", reason="needs the extra train")

from craternav_fg.training.detector import CraterNetwork, export  # noqa: E402
from craternav_fg.training.loop import TrainingOptions, train  # noqa: E402

pytestmark = [
    pytest.mark.slow,
    # PyTorch's exporter of files that OpenCV reads.
    pytest.mark.filterwarnings("ignore:You are using the legacy:DeprecationWarning"),
]


def test_a_run_that_was_stopped_ends_with_the_same_weights(tmp_path):
    losses = []
    whole = train(tmp_path / "whole", TrainingOptions(steps=3), lambda *args: losses.append(args))
    train(tmp_path / "parts", TrainingOptions(steps=2))
    parts = train(tmp_path / "parts", TrainingOptions(steps=3))
    for one, other in zip(whole.state_dict().values(), parts.state_dict().values(), strict=True):
        assert torch.equal(one, other)
    assert losses[-1][0] == 3
    assert all(np.isfinite(loss) for loss in losses[-1])
    with pytest.raises(InputError, match="expected seed 8, found 7"):
        train(tmp_path / "parts", TrainingOptions(steps=4, seed=8))


def test_a_checkpoint_of_another_program_is_one_line(tmp_path):
    train(tmp_path, TrainingOptions(steps=1))
    own = torch.load(tmp_path / "checkpoint.pt")
    others = {
        "expected steps, options, network, average, adam, found epoch, model": {"epoch": 3, "model": {}},
        "found steps, options, network, average$": {name: own[name] for name in own if name != "adam"},
        "found list": [1, 2],
        "expected seed 7, found None": {**own, "options": {}},
        "expected the network of this training": {**own, "network": {"weight": torch.zeros(2)}},
    }
    for message, stored in others.items():
        torch.save(stored, tmp_path / "checkpoint.pt")
        with pytest.raises(InputError, match=message):
            train(tmp_path, TrainingOptions(steps=2))


def test_the_exported_network_gives_the_same_in_opencv(tmp_path):
    torch.manual_seed(0)
    network = CraterNetwork().eval()
    export(network, tmp_path / "craters.onnx")
    assert (tmp_path / "craters.onnx").stat().st_size < 4 << 20
    image = np.random.default_rng(0).standard_normal((1, 1, 96, 160)).astype(np.float32)
    runner = cv2.dnn.readNetFromONNX(str(tmp_path / "craters.onnx"))
    runner.setInput(image)
    seen = runner.forward("cells")
    assert seen.shape == (1, 4, 96 // STRIDE_PX, 160 // STRIDE_PX)
    with torch.no_grad():
        np.testing.assert_allclose(seen, network(torch.from_numpy(image)).numpy(), atol=1e-4)
