"""Trained networks from checkpoints: de-renderers, predictors, and both together from images to D (the paper's Fig. 2)."""

import csv
import hashlib
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from jaxtyping import Float
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from torch import Tensor, nn

from cophy.dataset import generation
from cophy.dataset.estimates import Estimates
from cophy.dataset.experiment_set import ExperimentSet, NeededFrames
from cophy.dataset.features import (
    add_appearance,
    declared_inputs,
    estimated_inputs,
    not_derendered,
    reduce_to_frames,
    true_inputs,
)
from cophy.dataset.frames import to_image
from cophy.dataset.images import Images
from cophy.dataset.shards import ShardSet
from cophy.errors import CophyError
from cophy.models.derenderer import Derenderer
from cophy.scenario import Scenario
from cophy.scenario.rendering import RenderSettings
from cophy.training.checkpoints import misfit, read_checkpoint, read_file, restore_network
from cophy.training.metrics import NOT_FINITE
from cophy.training.reprojection import Evidence, check_intervention, check_seen, compare
from cophy.types import Inputs

DERENDERER = f"{Derenderer.__module__}.{Derenderer.__name__}"
FRAMES_PER_BATCH = 32

log = logging.getLogger(__name__)

SchemaT = TypeVar("SchemaT")


class TrainedDerenderer:
    """A de-renderer from a checkpoint. Every process that uses it reads it again, and must find the same bytes.

    Attributes:
        source: The checkpoint.
        name: A hash of its content.
        scenario: Name of the scenario it was trained on.
        split: Name of the split it was trained for.
        slots: Names of the objects.
        num_objects: Numbers of objects in its training images.
        render: How its training images were rendered.
        is_generated: Whether its training images were, so that their colours and camera are those of the scenario.
    """

    def __init__(self, source: Path) -> None:
        content = read_file(source)
        self.source, self.name = source, _name(content)
        self._origin = origin = read_checkpoint(content, source).origin
        if origin["model"]["_target_"] != DERENDERER:
            raise CophyError(f"{source} is a checkpoint of {origin['model']['_target_']}, not of a de-renderer")
        self.scenario, self.split = origin["scenario"]["name"], origin["split"]["name"]
        self.render = _typed(RenderSettings, origin["render"], source)
        self.is_generated = origin["source"].get("name") == "generated"
        slots, parts = origin["model"].get("slots"), [origin["split"].get(part) for part in ("train", "test")]
        counts = origin["num_objects"] or [part.get("num_objects") for part in parts if isinstance(part, dict)]
        if not isinstance(slots, list) or not counts or not all(isinstance(count, int) for count in counts):
            raise misfit(source, ValueError("model.slots or num_objects"))
        if not origin["trained_on"]:
            raise misfit(source, ValueError("trained_on"))
        self.slots, self.num_objects = list(map(str, slots)), frozenset(counts)
        self._training_data = {"data_seed": origin["data_seed"], "trained_on": origin["trained_on"][0]}
        self._network: Derenderer | None = None

    def check(self, sets: Sequence[ExperimentSet]) -> None:
        """Refuse datasets with another scenario, and those whose test experiments it may have been trained on."""
        for experiments in sets:
            stored, wanted = (
                {**keys, "task": None} for keys in (self._origin["scenario"], asdict(experiments.spec.scenario))
            )
            if keys := sorted(key for key in stored.keys() | wanted.keys() if stored.get(key) != wanted.get(key)):
                raise CophyError(
                    f"the de-renderer {self.source} was trained on another scenario (its {', '.join(keys)} differ)"
                )
            if not self.has_same_splits(experiments):
                raise CophyError(
                    f"the de-renderer {self.source} was trained with another data seed, or with other lists: it may "
                    f"have seen the test experiments of {experiments.id} in training"
                )

    def has_same_splits(self, experiments: ExperimentSet) -> bool:
        """Return whether its training had the splits of these experiments, so that it has seen none of their tests."""
        return experiments.has_same_splits(**self._training_data)

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """De-render (N, R, R, 3) uint8 images to positions (N, K, 3) in metres and presence logits (N, K).

        Raises:
            CophyError: An output is not finite.
        """
        network = self._loaded()
        images = torch.stack([to_image(frame, network.resolution) for frame in rgb])
        device = network.mean.device
        with torch.no_grad():
            outputs = [network(part.to(device).float() / 255) for part in torch.split(images, FRAMES_PER_BATCH)]
        position, presence = (torch.cat(parts).cpu().numpy() for parts in zip(*outputs, strict=True))
        _check_finite(np.concatenate([position, presence[..., None]], axis=-1), f"derenderer={self.source}")
        return position, presence

    def test_error(self) -> str | None:
        """Return its error on its own test images in words, from the run's metrics.json or the index of published weights."""
        index, run = self.source.parent / "index.csv", self.source.parent.parent / "metrics.json"
        metrics: Mapping[str, Any] = {}
        try:
            if index.is_file():
                with index.open(newline="") as lines:
                    metrics = next((row for row in csv.DictReader(lines) if row["sha256"][:8] == self.name), {})
            elif run.is_file():
                metrics = json.loads(run.read_bytes())["metrics"]
            error, accuracy = float(metrics["euclidean_error"]), float(metrics["presence_accuracy"])
            return f"{error:.2f} m, presence correct in {100 * accuracy:.1f} % of slots"
        except (KeyError, TypeError, ValueError, csv.Error):
            return None  # a run that is not over, or an index of earlier weights

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_network": None}

    def _loaded(self) -> Derenderer:
        if self._network is None:
            content = read_file(self.source)
            if _name(content) != self.name:
                raise CophyError(f"{self.source} was replaced while it was used: run again")
            network = restore_network(read_checkpoint(content, self.source), self.source)
            assert isinstance(network, Derenderer)
            self._network = network.eval().to("cuda" if torch.cuda.is_available() else "cpu")
        return self._network


def find_derenderer(
    outputs: Path, sets: Sequence[ExperimentSet], num_objects: set[int], split: str
) -> TrainedDerenderer:
    """Find the de-renderer among the runs in `outputs` that was trained on the scenario of `sets` with these numbers of objects.

    If there are several, take those that cannot have seen test experiments of `sets`; of these, the one trained for the same
    split, or the one trained on no other numbers of objects.

    Raises:
        CophyError: There is none, or more than one is left.
    """
    scenario = sets[0].spec.scenario.name
    runs = sorted(outputs.glob(f"{scenario}/*/derenderer*/*/*/seed*/metrics.json"))
    by_name: dict[str, TrainedDerenderer] = {}
    for path in (run.parent / "checkpoints" / "best.ckpt" for run in runs):
        try:
            derenderer = TrainedDerenderer(path)
        except CophyError as error:  # deleted, or of an earlier version
            log.warning("a de-renderer is left out: %s", error)
        else:
            by_name[derenderer.name] = derenderer
    suitable = [derenderer for derenderer in by_name.values() if num_objects <= derenderer.num_objects]
    suitable = [each for each in suitable if all(map(each.has_same_splits, sets))] or suitable
    suitable = [derenderer for derenderer in suitable if derenderer.split == split] or suitable
    suitable = [derenderer for derenderer in suitable if derenderer.num_objects == num_objects] or suitable
    if len(suitable) == 1:
        return suitable[0]
    objects = " and ".join(map(str, sorted(num_objects)))
    if not suitable:
        raise CophyError(
            f"no de-renderer of {scenario} with {objects} objects in {outputs}: train one (python src/train.py "
            f"model=derenderer scenario={scenario} split={split}), or name its checkpoint with derenderer="
        )
    paths = ", ".join(str(derenderer.source) for derenderer in suitable)
    raise CophyError(
        f"several de-renderers of {scenario} with {objects} objects: choose with derenderer= among {paths}"
    )


def _name(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:8]


class TrainedPredictor:
    """A predictor from a checkpoint, in evaluation mode. Only code of cophy.models and of a class that the user names runs.

    Args:
        scenarios: The classes of scenarios by name.
        model_class: The class of the checkpoint, for a model of the user.

    Attributes:
        source: The checkpoint.
        scenario: The scenario of its training data.
        size: Name of their size.
        data_seed: Their seed.
        positions: Where its training positions come from, see conf/train.yaml.
        appearance: What it sees besides positions: object_type, pose.
        network: From `Inputs` to `Prediction`.
    """

    def __init__(
        self, source: Path, scenarios: Mapping[str, type[Scenario]], model_class: type[nn.Module] | None = None
    ) -> None:
        checkpoint = read_checkpoint(read_file(source), source)
        origin = checkpoint.origin
        model = origin["model"]
        if model["_target_"] == DERENDERER:
            raise CophyError(f"predictor={source} is a checkpoint of a de-renderer, not of a predictor")
        declared = declared_inputs(model)
        if "confounders" in declared:
            raise CophyError(f"predictor={source} needs the true confounders, which no image shows")
        name = origin["scenario"]["name"]
        if name not in scenarios:
            raise CophyError(f"predictor={source} was trained on the scenario {name}, which does not exist here")
        self.appearance = declared
        self.source, self.data_seed, self.positions = source, origin["data_seed"], str(origin["positions"])
        self.size = str(origin["size"].get("name"))
        self.scenario: Scenario = _typed(scenarios[name], origin["scenario"], source)
        if model.get("num_frames") not in (None, self.scenario.clock.num_frames):
            raise misfit(source, ValueError(f"model.num_frames={model['num_frames']} is not that of its scenario"))
        self.network = restore_network(checkpoint, source, model_class).eval()

    def __call__(self, experiments: Mapping[str, Tensor]) -> Float[Tensor, "batch steps slots 3"]:
        """Predict D of each experiment from AB and C.

        Args:
            experiments: `states`, `presence` and `shape` of some experiments, as a DataLoader batches those of
                `cophy.load`. Of CD only C is used, `shape` only by a model that sees types or poses of objects.

        Returns:
            Positions in the frames after C, metres; zero in slots that are empty in C.
        """
        names = ("states", "presence", *["shape"] * bool(self.appearance))
        arrays = reduce_to_frames({name: experiments[name].numpy() for name in names}, self.scenario)
        inputs = add_appearance(true_inputs(arrays), arrays, self.appearance)
        with torch.no_grad():
            return self.network(inputs).position * inputs.presence[:, None, :, None]


def _typed(schema: type[SchemaT], keys: dict[str, Any], source: Path) -> SchemaT:
    """Build an object of a dataclass from keys of a checkpoint.

    Raises:
        CophyError: They do not fit the class; the message names the checkpoint.
    """
    try:
        built = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(schema), keys))
    except (OmegaConfBaseException, CophyError, ValueError) as error:
        raise misfit(source, error) from error
    assert isinstance(built, schema)
    return built


class Counterfactual(NamedTuple):
    """A predicted CD: positions (T, K, 3) in metres, first C and then D; presence (K,) of the objects found in C.

    observed, initial: how well the estimates of AB and C agree with the images.
    """

    positions: np.ndarray
    presence: np.ndarray
    observed: Evidence
    initial: Evidence


def check_pair(derenderer: TrainedDerenderer, predictor: TrainedPredictor) -> None:
    """Check that a predictor sees positions alone, and was trained on the de-renderer's scenario with the same colours."""
    if keys := not_derendered(predictor.appearance):
        raise CophyError(f"predictor={predictor.source} has {keys}, which no de-renderer estimates")
    if derenderer.scenario != predictor.scenario.name:
        raise CophyError(
            f"the de-renderer was trained on {derenderer.scenario}, the predictor on {predictor.scenario.name}"
        )
    if derenderer.slots != (slots := list(predictor.scenario.colors)):
        raise CophyError(
            f"derenderer={derenderer.source} was trained on {', '.join(derenderer.slots)}, "
            f"predictor={predictor.source} on {', '.join(slots)}"
        )


def predict(
    observed: np.ndarray, initial: np.ndarray, derenderer: TrainedDerenderer, predictor: TrainedPredictor
) -> Counterfactual:
    """Predict CD from images.

    Args:
        observed: (T, R, R, 3) uint8 RGB frames of AB.
        initial: (R, R, 3) uint8 RGB image of C.

    Raises:
        CophyError: The images do not fit the checkpoints, the de-renderer does not see what they show, or an output is not
            finite.
    """
    inputs, *evidence = see(observed, initial, derenderer, predictor.scenario)
    with torch.no_grad():
        prediction = predictor.network(inputs)
        positions = torch.cat([inputs.initial[:, None], prediction.position], dim=1).numpy()
    _check_finite(positions, f"predictor={predictor.source}")
    return Counterfactual(positions[0], inputs.presence[0].numpy(), *evidence)


def error_in_images(
    prediction: Counterfactual, truth: np.ndarray, derenderer: TrainedDerenderer, metric_dims: int
) -> float:
    """Return the MSE of a prediction, m², against what the de-renderer finds in images of the true CD.

    Args:
        truth: (T, R, R, 3) uint8 frames of CD, of which the first shows C.
        derenderer: Finds the objects in them; where it finds none, nothing is counted.
        metric_dims: Coordinates that count.

    Returns:
        NaN if it finds no object of the prediction in any frame.
    """
    position, logit = derenderer(truth)
    error = np.square(prediction.positions - position)[1:, :, :metric_dims].mean(axis=-1)
    counted = (logit[1:] > 0) & prediction.presence
    return float(error[counted].mean()) if counted.any() else float("nan")


def see(
    observed: np.ndarray, initial: np.ndarray, derenderer: TrainedDerenderer, scenario: Scenario
) -> tuple[Inputs, Evidence, Evidence]:
    """Estimate AB and C from images, and compare the estimates with these.

    Args:
        observed: (T, R, R, 3) uint8 RGB frames of AB.
        initial: (R, R, 3) uint8 RGB image of C.

    Returns:
        The estimates, and how well those of AB and of C agree with the images.

    Raises:
        CophyError: The images have another shape or number, or the de-renderer does not see what they show.
    """
    _check_images(observed, initial, scenario)
    (position, logit), (position_in_c, logit_in_c) = derenderer(observed), derenderer(initial[None])
    in_ab = compare(observed, position, logit, scenario, colors_known=derenderer.is_generated)
    in_c = compare(initial[None], position_in_c, logit_in_c, scenario, colors_known=derenderer.is_generated)
    check_seen("AB", in_ab, scenario)
    check_seen("C", in_c, scenario)
    moved_m = np.linalg.norm(position_in_c[0] - position[0], axis=-1)
    check_intervention(in_ab, in_c, moved_m, scenario, derenderer.num_objects)
    estimates = {
        "position": np.stack([position, np.broadcast_to(position_in_c, position.shape)])[None],
        "presence_logit": np.stack([logit, np.broadcast_to(logit_in_c, logit.shape)])[None],
    }
    return estimated_inputs(estimates, scenario), in_ab, in_c


def _check_finite(outputs: np.ndarray, checkpoint: str) -> None:
    if not np.isfinite(outputs).all():
        raise CophyError(f"{checkpoint} {NOT_FINITE}")


def _check_images(observed: np.ndarray, initial: np.ndarray, scenario: Scenario) -> None:
    clock = scenario.clock
    if len(observed) != clock.num_frames:
        expected = f"the predictor needs {clock.num_frames}, at {clock.frame_rate_hz} per second"
        raise CophyError(f"AB has {len(observed)} frames; {expected}")
    for name, frame in (("AB", observed[0]), ("C", initial)):
        if frame.shape[0] != frame.shape[1]:
            raise CophyError(f"the images of {name} are {frame.shape[1]} × {frame.shape[0]} pixels, not square")


def derender(
    sets: Sequence[ExperimentSet],
    derenderer: TrainedDerenderer,
    needed: NeededFrames,
    *,
    part: int,
    parts: int,
    workers: int,
) -> None:
    """Store estimates of positions and presence next to datasets.

    Args:
        sets: The datasets; they have to fit the de-renderer.
        part: Which part of the shards is made.
        parts: Number of parts. If there is only one, missing states and images are made first.

    Raises:
        CophyError: States or images are missing, which every part needs.
    """
    derenderer.check(sets)
    for experiments in sets:
        estimates = Estimates(experiments, derenderer, needed)
        if parts == 1:
            estimates.ensure(workers=workers)
        else:
            frames = estimates.frames
            for shards in (experiments, frames.best_available() if isinstance(frames, Images) else frames):
                if isinstance(shards, ShardSet) and not shards.is_finished():
                    raise CophyError(
                        f"{shards.directory} is not finished, which every part needs: run `{shards.command}`"
                    )
        generation.make_part(estimates, part, parts, workers=workers)
