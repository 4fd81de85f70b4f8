"""Trained predictors from Python, without a command line: `cophy.load_predictor`.

The data from Python, without a command line: `cophy.load`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from cophy.cli import OF_YOUR_OWN, explain
from cophy.config import experiments_of, settings
from cophy.dataset import generation
from cophy.dataset.experiment_dataset import ExperimentDataset
from cophy.dataset.source import GENERATED
from cophy.dataset.splits import SPLITS
from cophy.errors import CophyError
from cophy.scenario.rendering import MODALITIES
from cophy.schemas import SCENARIOS, TrainConfig, register
from cophy.training.trained import TrainedPredictor

STATES = "states"


def load(
    scenario: str,
    *,
    split: str | None = "train",
    size: str = "small",
    modalities: Sequence[str] = (STATES,),
    num_objects: int | None = None,
    data_seed: int = 0,
    resolution: int | None = None,
    source: str = "generated",
    root: str | Path | None = None,
    data_dir: str | Path = "data",
    workers: int = 2,
) -> ExperimentDataset:
    """Experiments as a torch Dataset of named tensors; what is missing is generated and rendered first.

    Generation starts processes: a script has to call this under `if __name__ == "__main__":`.

    Args:
        scenario: blocktower, balls or collision.
        split: train, val or test; None for all experiments.
        size: tiny, small, 12k or paper: how many experiments.
        modalities: states, and of pictures rgb, depth, segmentation. States and confounders are there in any case.
        num_objects: In A; None for those that the scenario's default split trains on.
        data_seed: Which dataset; its experiments follow from it.
        resolution: Edge of the pictures, pixels; None for the paper's 448. Released clips are as large as they are.
        source: generated; cophy or filtered_cophy for a released dataset.
        root: Folder of the released dataset.
        data_dir: Where generated data, and indices of released ones, lie.
        workers: Processes that generate and render.

    Raises:
        CophyError: A name does not exist, or data are damaged; the message says what to do.
    """
    if isinstance(modalities, str):
        raise CophyError(f"modalities: a tuple of names, as ('{modalities}',)")
    if unknown := set(modalities) - {STATES, *MODALITIES}:
        known = ", ".join((STATES, *MODALITIES))
        raise CophyError(f"modalities: there is no {', '.join(sorted(unknown))}; there are {known}")
    if split not in (None, *SPLITS):
        raise CophyError(f"split={split}: there are {', '.join(SPLITS)}, and None for all")
    if resolution is not None and source != GENERATED:
        raise CophyError(f"resolution={resolution}: released clips are as large as they are, leave it out")
    pictures = [name for name in MODALITIES if name in modalities]
    chosen: dict[str, Any] = {
        "source": source,  # before the scenario, which it changes
        "scenario": scenario,
        "size": size,
        "data_seed": data_seed,
        "data_dir": _quoted(data_dir),
        "render": "none" if not pictures else "rgb" if pictures == ["rgb"] else "all",
    }
    if root is not None:
        chosen["source.root"] = _quoted(root)
    if resolution is not None:
        chosen["render.resolution"] = resolution
    register()
    try:
        config: TrainConfig = settings("train", *(f"{key}={value}" for key, value in chosen.items()))
    except (HydraException, OmegaConfBaseException) as error:
        raise CophyError(explain(error).removesuffix(OF_YOUR_OWN)) from None  # Python has no such option
    (experiments,) = experiments_of(config, [num_objects or config.split.train.num_objects])
    frames = experiments.frames(config.render) if pictures else None
    if frames is None:
        generation.ensure(experiments, workers=workers)
    else:
        frames.ensure(workers=workers)
    return ExperimentDataset(experiments, split=split, frames=frames, modalities=pictures)


def _quoted(path: str | Path) -> str:
    escaped = str(path).replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def load_predictor(checkpoint: str | Path) -> TrainedPredictor:
    """A trained predictor: called with a batch of experiments, it says what D would be.

    Args:
        checkpoint: Of train.py, for example outputs/…/checkpoints/best.ckpt. Reading it runs no code of it.

    Raises:
        CophyError: The file is something else, or its predictor is given the true confounders.
    """
    return TrainedPredictor(Path(checkpoint), SCENARIOS)
