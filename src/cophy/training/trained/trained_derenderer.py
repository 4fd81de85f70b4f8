"""Trained de-renderers: reading them from a checkpoint, and finding the one that a run needs."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cophy.dataset.feed.frame_dataset import to_image
from cophy.dataset.store.experiment_set import ExperimentSet
from cophy.errors import CophyError
from cophy.models.derenderer import Derenderer
from cophy.scenario.rendering.frames import Backend, RenderSettings
from cophy.training.trained.checkpoints import made_from, read_bytes, read_checkpoint
from cophy.training.trained.network import restore_network

TARGET = f"{Derenderer.__module__}.{Derenderer.__name__}"
MAX_FRAMES_AT_ONCE = 32


class TrainedDerenderer:
    """The network of a checkpoint; read again in every process that uses it, which must find the same bytes.

    Attributes:
        source: Where the checkpoint lies.
        name: A hash of its content.
        scenario: Name of the scenario it knows.
        split: Name of the split it was trained for.
        slots: Names of the objects it knows.
        num_objects: How many of them it has seen at once.
        render: The pictures it knows.
    """

    def __init__(self, source: Path) -> None:
        content = read_bytes(source)
        self.source, self.name = source, _name(content)
        self._origin = origin = read_checkpoint(content, source).origin
        if origin.model["_target_"] != TARGET:
            raise CophyError(f"{source} is a checkpoint of {origin.model['_target_']}, not of a de-renderer")
        self.scenario, self.split = str(origin.scenario["name"]), str(origin.split["name"])
        render = origin.render
        with made_from(source):
            self.slots = list(map(str, origin.model["slots"]))
            of_split = (origin.split[part]["num_objects"] for part in ("train", "test"))
            self.num_objects: frozenset[int] = frozenset(map(int, origin.num_objects or of_split))
            self.render = RenderSettings(render["modalities"], int(render["resolution"]), Backend(render["backend"]))
            self._seen = {
                "num_experiments": origin.size["num_experiments"],
                "data_seed": origin.data_seed,
                "trained_on": origin.trained_on[0],
            }
        self._network: Derenderer | None = None

    def check(self, sets: Sequence[ExperimentSet]) -> None:
        """Refuse datasets that it was not trained for: its slots, camera, and test experiments would not be theirs."""
        for experiments in sets:
            own, wanted = (
                {**keys, "task": None} for keys in (self._origin.scenario, asdict(experiments.spec.scenario))
            )
            if differing := sorted(key for key in own.keys() | wanted.keys() if own.get(key) != wanted.get(key)):
                raise CophyError(f"the de-renderer {self.source} is of another scenario (its {', '.join(differing)})")
            if not experiments.unseen_by(**self._seen):
                raise CophyError(
                    f"the de-renderer {self.source} was trained at another size or data seed, or with other lists: it may "
                    f"have seen the test experiments of {experiments.id} in training"
                )

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, R, R, 3) uint8 -> positions (N, K, 3) in metres, presence logits (N, K)."""
        network = self._loaded()
        images = torch.stack([to_image(frame, network.resolution) for frame in rgb])
        device = network.mean.device
        with torch.no_grad():
            found = [network(part.to(device).float() / 255) for part in torch.split(images, MAX_FRAMES_AT_ONCE)]
        position, presence = (torch.cat(parts).cpu().numpy() for parts in zip(*found, strict=True))
        return position, presence

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_network": None}

    def _loaded(self) -> Derenderer:
        if self._network is None:
            torch.set_num_threads(1)  # processes work side by side
            content = read_bytes(self.source)
            if _name(content) != self.name:
                raise CophyError(f"{self.source} was replaced while it was used: run again")
            weights = read_checkpoint(content, self.source).weights
            with made_from(self.source):
                network = restore_network(self._origin.model, weights)
            assert isinstance(network, Derenderer)
            self._network = network.eval().to("cuda" if torch.cuda.is_available() else "cpu")
        return self._network


def find_derenderer(outputs: Path, scenario: str, num_objects: set[int], split: str) -> TrainedDerenderer:
    """The one de-renderer among the runs in `outputs` that knows the scenario with these numbers of objects.

    Of several, the one that was trained for the same split is meant, or the one that knows no other numbers of objects.

    Args:
        outputs: Root of all runs.
        scenario: Name of the scenario.
        num_objects: Numbers of objects that it has to know.
        split: Name of the split that it is needed for.

    Raises:
        CophyError: There is none, or more than one is left.
    """
    places = sorted(outputs.glob(f"{scenario}/*/derenderer*/*/*/seed*/metrics.json"))
    known = {d.name: d for d in (TrainedDerenderer(place.parent / "checkpoints" / "best.ckpt") for place in places)}
    able = [derenderer for derenderer in known.values() if num_objects <= derenderer.num_objects]
    able = [derenderer for derenderer in able if derenderer.split == split] or able
    able = [derenderer for derenderer in able if derenderer.num_objects == num_objects] or able
    if len(able) == 1:
        return able[0]
    objects = " and ".join(map(str, sorted(num_objects)))
    if not able:
        raise CophyError(
            f"no de-renderer of {scenario} with {objects} objects in {outputs}: train one (python src/train.py "
            f"model=derenderer scenario={scenario} split={split}), or name its checkpoint with derenderer="
        )
    found = ", ".join(str(derenderer.source) for derenderer in able)
    raise CophyError(
        f"several de-renderers of {scenario} with {objects} objects: choose with derenderer= among {found}"
    )


def _name(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:8]
