"""Which noise alongside_noisy should be trained with: MSE on validation experiments whose positions are estimated from images.

python benchmarks/results/noise_on_validation.py checkpoints/collision_derenderer.ckpt RUN/checkpoints/best.ckpt ...

Towers of three and collisions, size=small, data seed 0. Renders and de-renders AB and C of 300 validation experiments, which takes minutes.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

import cophy
from cophy.config import folder
from cophy.dataset.features import estimated_inputs, to_batch
from cophy.scenario import Scenario
from cophy.scenario.rendering import Renderer
from cophy.training.metrics import mean_squared_error
from cophy.training.trained import TrainedDerenderer

NUM_EXPERIMENTS = 300  # the first of the split


def main(derenderer: Path, predictors: list[Path], data_dir: Path) -> None:
    """Print the error of the de-renderer, and of each predictor from true and from estimated positions."""
    trained = TrainedDerenderer(derenderer)
    data = cophy.load(trained.scenario, split="val", data_dir=data_dir)
    arrays = {name: array[:NUM_EXPERIMENTS] for name, array in data.arrays.items()}
    batch = to_batch(arrays, data.scenario)
    inputs = estimated_inputs(estimates(trained, arrays, data.scenario), data.scenario)
    has_same_objects = (inputs.presence == batch.inputs.presence).all(dim=1)
    error = (inputs.initial - batch.inputs.initial)[batch.inputs.presence & inputs.presence].norm(dim=-1).mean()
    print(
        f"{len(has_same_objects)} validation experiments, {has_same_objects.sum()} with the right objects in C; mean error in C {error:.3f} m"
    )
    squared_error = mean_squared_error(data.scenario.task.metric_dims)
    for path in predictors:
        network = cophy.load_predictor(path).network
        with torch.no_grad():
            true, estimated = (
                squared_error(network(each), batch.targets)[has_same_objects] for each in (batch.inputs, inputs)
            )
        print(f"{path}: true positions {true.mean():.4f} m², estimated {estimated.mean():.4f} m²")


def estimates(
    derenderer: TrainedDerenderer, arrays: Mapping[str, np.ndarray], scenario: Scenario
) -> dict[str, np.ndarray]:
    """Return what a de-renderer sees in AB and in C of each experiment, as `cophy.dataset.estimates.Estimates` stores it."""
    states = arrays["states"][:, :, :: scenario.clock.states_per_frame]
    position, presence_logit = np.zeros_like(states[..., :3]), np.zeros_like(states[..., 0])
    with Renderer(scenario, derenderer.render.resolution) as renderer:
        for row, sequence in np.ndindex(states.shape[:2]):
            frames = slice(None) if sequence == 0 else slice(1)
            seen = states[row, sequence, frames]
            images = renderer.render(
                seen[..., :3],
                seen[..., 3:7],
                presence=arrays["presence"][row, sequence],
                shapes=arrays["shape"][row].tolist(),
                background_seed=int(arrays["background_seed"][row]),
            )
            place = row, sequence, frames
            position[place], presence_logit[place] = derenderer(images.rgb)
    return {"position": position, "presence_logit": presence_logit}


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("derenderer", type=Path, help="checkpoint of a de-renderer, which says which scenario")
    parser.add_argument("predictors", type=Path, nargs="+", help="checkpoints of predictors of this scenario")
    parser.add_argument("--data-dir", type=Path, default=Path(folder("COPHY_DATA")), help="where the dataset lies")
    main(**vars(parser.parse_args()))
