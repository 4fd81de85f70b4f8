"""What a trained de-renderer sees in the frames of a dataset, kept beside it.

Trained de-renderers: reading them from a checkpoint, and finding the one that a run needs.
Trained predictors: the network of a checkpoint, and the scenario that it was trained on.
From the pictures of AB and C, with two checkpoints, to D (the whole of the paper's Fig. 2).
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from omegaconf import OmegaConf
from torch import Tensor

from cophy.dataset import generation
from cophy.dataset.estimates import Estimates
from cophy.dataset.experiment_set import ExperimentSet, NeededFrames
from cophy.dataset.features import DeclaredInputs, estimated_inputs, true_inputs
from cophy.dataset.frames import to_image
from cophy.dataset.images import Images
from cophy.dataset.shards import ShardSet
from cophy.errors import CophyError
from cophy.models.derenderer import Derenderer
from cophy.scenario import Scenario
from cophy.scenario.rendering import Backend, RenderSettings
from cophy.training.checkpoints import made_from, read_bytes, read_checkpoint, restore_network
from cophy.training.predictor import NOT_FINITE

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


ALLOWED = "cophy.models."  # whose classes a checkpoint may name: importing any other module would run its code


class TrainedPredictor:
    """The network of a checkpoint, in evaluation mode, and the data that it was trained on.

    Args:
        source: The checkpoint.
        scenarios: The classes of scenarios by name.

    Attributes:
        source: The checkpoint.
        scenario: Of the data.
        size: Name of their size. Test it on data of this size: most test experiments of another are among those it was
            trained on.
        data_seed: Of the data.
        network: From `Inputs` to `Prediction`.
    """

    def __init__(self, source: Path, scenarios: Mapping[str, type[Scenario]]) -> None:
        checkpoint = read_checkpoint(read_bytes(source), source)
        model = checkpoint.origin.model
        target = str(model["_target_"])
        if not target.startswith(ALLOWED) or target == TARGET:
            raise CophyError(
                f"predictor={source} is a checkpoint of {target}: only predictors of cophy.models are loaded"
            )
        declared = DeclaredInputs.of(model)
        if declared.confounders:
            raise CophyError(f"predictor={source} wants the true confounders, which no picture shows")
        if declared.not_derendered:
            raise CophyError(f"predictor={source} has {declared.not_derendered}, which no de-renderer estimates")
        name = str(checkpoint.origin.scenario["name"])
        if name not in scenarios:
            raise CophyError(f"predictor={source} is of the scenario {name}, which is not known here")
        self.source, self.data_seed = source, checkpoint.origin.data_seed
        self.size = str(checkpoint.origin.size.get("name"))
        with made_from(source):
            self.scenario = _scenario(checkpoint.origin.scenario, scenarios[name])
            self.network = restore_network(model, checkpoint.weights).eval()

    def __call__(self, experiments: Mapping[str, Tensor]) -> Float[Tensor, "batch steps slots 3"]:
        """D of each experiment from its AB and C.

        Args:
            experiments: `states` and `presence` of some experiments, as a DataLoader batches those of `cophy.load`.
                Of CD only C is looked at.

        Returns:
            Positions in the frames after C, metres; zero in slots that C leaves empty.
        """
        inputs = true_inputs(experiments["states"].numpy(), experiments["presence"].numpy(), self.scenario)
        with torch.no_grad():
            return self.network(inputs).position * inputs.presence[:, None, :, None]


def _scenario(keys: dict[str, Any], schema: type[Scenario]) -> Scenario:
    scenario = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(schema), keys))
    assert isinstance(scenario, Scenario)
    return scenario


class Counterfactual(NamedTuple):
    """What is predicted of CD. positions: (T, K, 3) metres, C and then D. presence: (K,) the objects found in C."""

    positions: np.ndarray
    presence: np.ndarray


def check_pair(derenderer: TrainedDerenderer, predictor: TrainedPredictor) -> None:
    """Refuse checkpoints of two scenarios, or of one with other colours."""
    if derenderer.scenario != predictor.scenario.name:
        raise CophyError(f"the de-renderer is of {derenderer.scenario}, the predictor of {predictor.scenario.name}")
    if derenderer.slots != (slots := list(predictor.scenario.colors)):
        seen, known = ", ".join(derenderer.slots), ", ".join(slots)
        raise CophyError(f"derenderer={derenderer.source} sees {seen}, predictor={predictor.source} knows {known}")


def predict(
    observed: np.ndarray, initial: np.ndarray, derenderer: TrainedDerenderer, predictor: TrainedPredictor
) -> Counterfactual:
    """What would have happened from C, having seen AB.

    Args:
        observed: (T, R, R, 3) uint8 RGB frames of AB.
        initial: (R, R, 3) uint8 RGB picture of C.
        derenderer: Finds the objects in both.
        predictor: Predicts D from them.

    Raises:
        CophyError: The pictures are not those that the checkpoints know, or show no object; or what a checkpoint says of
            them is not finite.
    """
    _check_pictures(observed, initial, predictor.scenario)
    position, logit = derenderer(observed)
    position_in_c, logit_in_c = (
        np.broadcast_to(value, like.shape)
        for value, like in zip(derenderer(initial[None]), (position, logit), strict=True)
    )
    estimates = {
        "position": np.stack([position, position_in_c])[None],
        "presence_logit": np.stack([logit, logit_in_c])[None],
    }
    _check_finite(estimates["position"], f"derenderer={derenderer.source}")
    inputs = estimated_inputs(estimates, predictor.scenario)
    if not inputs.presence.any():
        raise CophyError("the de-renderer sees no object in C: is it trained, and is the picture of its scenario?")
    with torch.no_grad(), made_from(predictor.source):  # some arguments of a network are only used here
        prediction = predictor.network(inputs)
        positions = torch.cat([inputs.initial[:, None], prediction.position], dim=1).numpy()
    _check_finite(positions, f"predictor={predictor.source}")
    return Counterfactual(positions[0], inputs.presence[0].numpy())


def _check_finite(positions: np.ndarray, checkpoint: str) -> None:
    if not np.isfinite(positions).all():
        raise CophyError(f"{checkpoint} {NOT_FINITE}")


def _check_pictures(observed: np.ndarray, initial: np.ndarray, scenario: Scenario) -> None:
    clock = scenario.clock
    if len(observed) != clock.num_frames:
        known = f"the predictor knows {clock.num_frames}, at {clock.frame_rate_hz} per second"
        raise CophyError(f"AB has {len(observed)} frames; {known}")
    for name, frame in (("AB", observed[0]), ("C", initial)):
        if frame.shape[0] != frame.shape[1]:
            raise CophyError(f"the pictures of {name} are {frame.shape[1]} × {frame.shape[0]} pixels, not square")


def derender(
    sets: Sequence[ExperimentSet],
    derenderer: TrainedDerenderer,
    needed: NeededFrames,
    *,
    part: int,
    parts: int,
    workers: int,
) -> None:
    """Estimate positions and presence.

    Args:
        sets: The datasets; ones that the de-renderer was not trained for are refused.
        derenderer: Looks at their frames.
        needed: At which of them.
        part: Which part of the shards is made.
        parts: How many there are. Of a single one, states and pictures that are missing are made first.
        workers: Processes.

    Raises:
        CophyError: States or pictures are missing, which every part needs.
    """
    derenderer.check(sets)
    for experiments in sets:
        estimates = Estimates(experiments, derenderer, needed)
        if parts == 1:
            estimates.ensure(workers=workers)
        else:
            frames = estimates.frames
            for made in (experiments, frames.or_more() if isinstance(frames, Images) else frames):
                if isinstance(made, ShardSet) and not made.is_finished():
                    raise CophyError(f"{made.directory} is not finished, which every part needs: run `{made.command}`")
        generation.make_part(estimates, part, parts, workers=workers)
