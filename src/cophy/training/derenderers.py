"""Trained de-renderers: reading them from a checkpoint, and finding the one that a row needs."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cophy.dataset.external import ExternalStates
from cophy.dataset.frames import to_image
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.models.derenderer import Derenderer
from cophy.scenario.rendering import Backend, RenderSettings
from cophy.training.checkpoints import read_checkpoint, weights_of

TARGET = f"{Derenderer.__module__}.{Derenderer.__name__}"
FRAMES_AT_ONCE = 32


class TrainedDerenderer:
    """The network of a checkpoint; read again in every process that uses it, which must find the same bytes.

    name: a hash of the checkpoint. render: the pictures it knows. num_objects: how many objects it has seen at once.
    """

    def __init__(self, source: Path) -> None:
        content = read_bytes(source)
        self.source, self.name = source, hashlib.sha256(content).hexdigest()[:8]
        self._config = config = read_checkpoint(content, source)["config"]
        if config["model"]["_target_"] != TARGET:
            raise CophyError(f"{source} is a checkpoint of {config['model']['_target_']}, not of a de-renderer")
        self.scenario: str = config["scenario"]["name"]
        self.split: str = config["split"]["name"]
        self.num_objects = frozenset(
            config["num_objects"] or (config["split"][p]["num_objects"] for p in ("train", "test"))
        )
        render = config["render"]
        self.render = RenderSettings(render["modalities"], render["resolution"], Backend(render["backend"]))
        self._network: Derenderer | None = None

    def check(self, sets: Sequence[States | ExternalStates]) -> None:
        """Refuse datasets that it was not trained for: its slots, camera, and test experiments would not be theirs."""
        for states in sets:
            own, wanted = {**self._config["scenario"], "task": None}, {**asdict(states.spec.scenario), "task": None}
            differing = sorted(key for key in own.keys() | wanted.keys() if own.get(key) != wanted.get(key))
            if differing:
                raise CophyError(f"the de-renderer {self.source} is of another scenario (its {', '.join(differing)})")
            if isinstance(states, States):
                trained = (self._config["size"]["num_experiments"], self._config["data_seed"])
                same = trained == (states.spec.size.num_experiments, states.spec.seed)
            else:
                same = states.id in self._config.get("trained_on", [[]])[0]
            if not same:
                raise CophyError(
                    f"the de-renderer {self.source} was trained at another size or data seed, or with other lists: it may "
                    f"have seen the test experiments of {states.id} in training"
                )

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, R, R, 3) uint8 -> positions (N, K, 3) in metres, presence logits (N, K)."""
        network = self._loaded()
        images = torch.stack([to_image(frame, network.resolution) for frame in rgb])
        device = network.mean.device
        with torch.no_grad():
            found = [network(part.to(device).float() / 255) for part in torch.split(images, FRAMES_AT_ONCE)]
        position, presence = (torch.cat(parts).cpu().numpy() for parts in zip(*found, strict=True))
        return position, presence

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_network": None}

    def _loaded(self) -> Derenderer:
        if self._network is None:
            torch.set_num_threads(1)  # processes work side by side
            content = read_bytes(self.source)
            if hashlib.sha256(content).hexdigest()[:8] != self.name:
                raise CophyError(f"{self.source} was replaced while it was used: run again")
            checkpoint = read_checkpoint(content, self.source)
            arguments = {key: value for key, value in self._config["model"].items() if key != "_target_"}
            network = Derenderer(**arguments)
            network.load_state_dict(weights_of(checkpoint))
            self._network = network.eval().to("cuda" if torch.cuda.is_available() else "cpu")
        return self._network


def read_bytes(path: Path) -> bytes:
    """A checkpoint's bytes."""
    if not path.is_file():
        raise CophyError(
            f"{path} is no file: give a checkpoint of train.py, for example outputs/.../checkpoints/best.ckpt"
        )
    return path.read_bytes()


def find(outputs: Path, scenario: str, num_objects: set[int], split: str) -> TrainedDerenderer:
    """The one de-renderer among the runs in `outputs` that knows the scenario with these numbers of objects.

    Of several, the one that was trained for the same split is meant, or the one that knows no other numbers of objects.
    """
    places = sorted(outputs.glob(f"{scenario}/*/derenderer*/*/*/seed*/metrics.json"))
    known = {d.name: d for d in (TrainedDerenderer(place.parent / "checkpoints" / "best.ckpt") for place in places)}
    fitting = [derenderer for derenderer in known.values() if num_objects <= derenderer.num_objects]
    fitting = [derenderer for derenderer in fitting if derenderer.split == split] or fitting
    fitting = [derenderer for derenderer in fitting if derenderer.num_objects == num_objects] or fitting
    if len(fitting) == 1:
        return fitting[0]
    objects = " and ".join(map(str, sorted(num_objects)))
    if not fitting:
        raise CophyError(
            f"no de-renderer of {scenario} with {objects} objects in {outputs}: train one (python src/train.py "
            f"model=derenderer scenario={scenario} split={split}), or name its checkpoint with derenderer="
        )
    found = ", ".join(str(derenderer.source) for derenderer in fitting)
    raise CophyError(
        f"several de-renderers of {scenario} with {objects} objects: choose with derenderer= among {found}"
    )
