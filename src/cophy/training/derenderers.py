"""Trained de-renderers: reading them from a checkpoint, and finding the one that a row needs."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cophy.dataset.frames import to_image
from cophy.errors import CophyError
from cophy.files import sha256
from cophy.models.derenderer import Derenderer
from cophy.scenario.rendering import Backend, RenderSettings

TARGET = f"{Derenderer.__module__}.{Derenderer.__name__}"
FRAMES_AT_ONCE = 32


class TrainedDerenderer:
    """The network of a checkpoint; read again, without running code from it, in every process that uses it."""

    def __init__(self, source: Path) -> None:
        self.source = source
        config = read_checkpoint(source)["config"]
        if config["model"]["_target_"] != TARGET:
            raise CophyError(
                f"derenderer={source} is a checkpoint of {config['model']['_target_']}, not of a de-renderer"
            )
        self.name = sha256(source)[:8]
        self.scenario: str = config["scenario"]["name"]
        self.num_objects = {config["split"][part]["num_objects"] for part in ("train", "test")}
        render = config["render"]
        self.render = RenderSettings(render["modalities"], render["resolution"], Backend(render["backend"]))
        self._network: Derenderer | None = None

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, R, R, 3) uint8 -> positions (N, K, 3) in metres, presence logits (N, K)."""
        network = self._loaded()
        images = torch.stack([to_image(frame, network.resolution) for frame in rgb])
        device = network.bias.device
        with torch.no_grad():
            found = [network(part.to(device).float() / 255) for part in torch.split(images, FRAMES_AT_ONCE)]
        position, presence = (torch.cat(parts).cpu().numpy() for parts in zip(*found, strict=True))
        return position, presence

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_network": None}

    def _loaded(self) -> Derenderer:
        if self._network is None:
            torch.set_num_threads(1)  # processes work side by side
            checkpoint = read_checkpoint(self.source)
            arguments = {key: value for key, value in checkpoint["config"]["model"].items() if key != "_target_"}
            network = Derenderer(**arguments)
            prefix = "network."
            weights = {k.removeprefix(prefix): v for k, v in checkpoint["state_dict"].items() if k.startswith(prefix)}
            network.load_state_dict(weights)
            self._network = network.eval().to("cuda" if torch.cuda.is_available() else "cpu")
        return self._network


def read_checkpoint(path: Path) -> dict[str, Any]:
    """A checkpoint of train.py; reading it runs no code (weights_only)."""
    if not path.is_file():
        raise CophyError(
            f"{path} is no file: give a checkpoint of train.py, for example outputs/.../checkpoints/best.ckpt"
        )
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        content["config"]["model"]["_target_"]
    except (pickle.UnpicklingError, RuntimeError, KeyError, TypeError, EOFError) as error:
        raise CophyError(f"{path} is no checkpoint of train.py, or a damaged one") from error
    return content


def find(outputs: Path, scenario: str, num_objects: set[int]) -> TrainedDerenderer:
    """The one de-renderer among the runs in `outputs` that knows the scenario with these numbers of objects."""
    places = sorted(outputs.glob(f"{scenario}/*/derenderer*/*/*/seed*/metrics.json"))
    known = [TrainedDerenderer(place.parent / "checkpoints" / "best.ckpt") for place in places]
    fitting = [derenderer for derenderer in known if num_objects <= derenderer.num_objects]
    if len(fitting) == 1:
        return fitting[0]
    objects = " and ".join(map(str, sorted(num_objects)))
    if not fitting:
        raise CophyError(
            f"no de-renderer of {scenario} with {objects} objects in {outputs}: train one (python src/train.py "
            f"model=derenderer scenario={scenario} split=...), or name its checkpoint with derenderer="
        )
    found = ", ".join(str(derenderer.source) for derenderer in fitting)
    raise CophyError(
        f"several de-renderers of {scenario} with {objects} objects: choose with derenderer= among {found}"
    )
