"""From the pictures of AB and C, with two checkpoints, to D (the whole of the paper's Fig. 2)."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from cophy.dataset.counterfactual import with_estimates
from cophy.errors import CophyError
from cophy.scenario import Blocktower, Scenario, Shape
from cophy.scenario.rendering import Renderer
from cophy.training.checkpoints import read_checkpoint, weights_of
from cophy.training.derenderers import TARGET, TrainedDerenderer, read_bytes
from cophy.training.run import build_network
from cophy.types import CONFOUNDERS, Batch


class Counterfactual(NamedTuple):
    """positions: (T, K, 3) metres, C and then D. presence: (K,) the objects found in C."""

    positions: np.ndarray
    presence: np.ndarray


class TrainedPredictor:
    """The network of a checkpoint, and the scenario that it was trained on."""

    def __init__(self, source: Path) -> None:
        checkpoint = read_checkpoint(read_bytes(source), source)
        config = checkpoint["config"]
        target = config["model"]["_target_"]
        if not target.startswith("cophy.models.") or target == TARGET:
            raise CophyError(
                f"predictor={source} is a checkpoint of {target}: only predictors of cophy.models are loaded"
            )
        if config["model"].get("confounders") == "ground_truth":
            raise CophyError(f"predictor={source} wants the true confounders, which no picture shows")
        schema = ConfigStore.instance().load(f"schema/scenario/{config['scenario']['name']}.yaml").node
        scenario: Any = OmegaConf.to_object(OmegaConf.merge(schema, config["scenario"]))
        assert isinstance(scenario, Scenario)
        self.scenario = scenario
        self.network = build_network(config["model"]).eval()
        try:
            self.network.load_state_dict(weights_of(checkpoint))
        except RuntimeError as error:
            raise CophyError(f"predictor={source} does not fit {config['model']['_target_']} as it is now") from error


def predict(
    observed: np.ndarray, initial: np.ndarray, derenderer: TrainedDerenderer, predictor: TrainedPredictor
) -> Counterfactual:
    """What would have happened from C (R, R, 3), having seen AB (T, R, R, 3), both uint8 RGB and square."""
    num_frames = predictor.scenario.clock.num_frames
    if len(observed) != num_frames:
        rate = predictor.scenario.clock.frame_rate_hz
        raise CophyError(f"AB has {len(observed)} frames; the predictor knows {num_frames}, at {rate} per second")
    for name, frame in (("AB", observed[0]), ("C", initial)):
        if frame.shape[0] != frame.shape[1]:
            raise CophyError(f"the pictures of {name} are {frame.shape[1]} × {frame.shape[0]} pixels, not square")
    position, logit = derenderer(observed)
    position_in_c, logit_in_c = (
        np.broadcast_to(value, like.shape)
        for value, like in zip(derenderer(initial[None]), (position, logit), strict=True)
    )
    estimates = {
        "position": np.stack([position, position_in_c])[None],
        "presence_logit": np.stack([logit, logit_in_c])[None],
    }
    batch = with_estimates(_unknown(num_frames, predictor.scenario.num_slots), estimates, predictor.scenario)
    if not batch.presence.any():
        raise CophyError("the de-renderer sees no object in C: is it trained, and is the picture of its scenario?")
    with torch.no_grad():
        prediction = predictor.network(batch)
    positions = torch.cat([batch.initial[:, None], prediction.position], dim=1)
    return Counterfactual(positions[0].numpy(), batch.presence[0].numpy())


def redraw(found: Counterfactual, scenario: Scenario, resolution: int) -> np.ndarray:
    """(T, R, R, 3) pictures of what was predicted. Positions tell neither shape nor rotation: towers are drawn of upright
    blocks, the others of spheres."""
    shape = Shape.BOX if isinstance(scenario, Blocktower) else Shape.SPHERE
    upright = np.broadcast_to((0.0, 0.0, 0.0, 1.0), (*found.positions.shape[:2], 4))
    with Renderer(scenario, resolution) as renderer:
        shapes = [int(shape)] * scenario.num_slots
        frames = renderer.render(found.positions, upright, presence=found.presence, shapes=shapes, background_seed=0)
    return frames.rgb


def _unknown(num_frames: int, num_slots: int) -> Batch:
    """One experiment of which nothing is known."""
    steps, absent = (1, num_frames - 1, num_slots), torch.zeros(1, num_slots, dtype=torch.bool)
    return Batch(
        observed=torch.zeros(1, num_frames, num_slots, 3),
        observed_presence=absent,
        observed_stable=torch.zeros(steps, dtype=torch.bool),
        initial=torch.zeros(1, num_slots, 3),
        presence=absent,
        confounders=torch.zeros(1, num_slots, len(CONFOUNDERS)),
        confounder_class=torch.zeros(1, num_slots, 2, dtype=torch.long),
        target=torch.zeros(*steps, 3),
        target_initial=torch.zeros(1, num_slots, 3),
        target_presence=absent,
        stable=torch.zeros(steps, dtype=torch.bool),
    )
