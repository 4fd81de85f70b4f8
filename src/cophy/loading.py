"""Data and trained predictors from Python, without the command line: `cophy.load` and `cophy.load_predictor`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torch import nn

from cophy.cli import settings_from_python
from cophy.config import experiments_of
from cophy.dataset import generation
from cophy.dataset.archive import opened
from cophy.dataset.datamodules import ExperimentDataset
from cophy.dataset.experiment_set import ALL_FRAMES, TEST, ExperimentSet
from cophy.dataset.images import Images
from cophy.dataset.source import GENERATED
from cophy.dataset.splits import SPLITS
from cophy.errors import CophyError
from cophy.scenario.rendering import MODALITIES
from cophy.schemas import SCENARIOS, TrainConfig
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
    data_dir: str | Path | None = None,
    workers: int = 2,
) -> ExperimentDataset:
    """Return experiments as a torch Dataset of named tensors; missing data are generated and rendered first.

    Args:
        scenario: blocktower, balls or collision.
        split: train, val or test; None for all experiments.
        size: sample, tiny, small, 12k or paper: how many experiments.
        modalities: states, rgb, depth, segmentation. States and confounders are always included.
        num_objects: Objects in A; None for the number that the scenario's default split trains on.
        data_seed: Seed of the dataset.
        resolution: Edge of the images, pixels; None for the paper's 448. Released clips have their own.
        source: generated; cophy or filtered_cophy for a released dataset.
        root: Folder of the released dataset. For generated data, where they are copied from: a data directory, a zip archive of
            export.py, or the URL of one.
        data_dir: Folder of generated data and of indices of released data; None for $COPHY_DATA, or data.
        workers: Processes that generate and render.

    Raises:
        CophyError: A name does not exist, or data are damaged; the message says what to do.
    """
    if isinstance(modalities, str):
        raise CophyError(f"modalities: must be a tuple of names, as ('{modalities}',)")
    if unknown := set(modalities) - {STATES, *MODALITIES}:
        known = ", ".join((STATES, *MODALITIES))
        raise CophyError(f"modalities: {', '.join(sorted(unknown))} does not exist; there are {known}")
    if split not in (None, *SPLITS):
        raise CophyError(f"split={split}: there are {', '.join(SPLITS)}, and None for all")
    if resolution is not None and source != GENERATED:
        raise CophyError(f"resolution={resolution}: released clips have their own, leave it out")
    images = [name for name in MODALITIES if name in modalities]
    overrides: dict[str, Any] = {
        "source": source,  # before the scenario, which it changes
        "scenario": scenario,
        "size": size,
        "data_seed": data_seed,
        "render": "none" if not images else "rgb" if images == ["rgb"] else "all",
    }
    if data_dir is not None:
        overrides["data_dir"] = _quoted(data_dir)
    if root is not None and source != GENERATED:
        overrides["source.root"] = _quoted(root)
    if resolution is not None:
        overrides["render.resolution"] = resolution
    config: TrainConfig = settings_from_python("train", *(f"{key}={value}" for key, value in overrides.items()))
    count = num_objects or config.split.train.num_objects
    counted = config.size.num_experiments.get(scenario, {})
    if source == GENERATED and count not in (possible := [n for n in config.scenario.num_objects if str(n) in counted]):
        choices = ", ".join(map(str, possible)) or "none"
        raise CophyError(f"num_objects={count}: scenario={scenario} has {choices} in size={size}")
    (experiments,) = experiments_of(config, [count])
    frames = experiments.frames(config.render, TEST if split == "test" else ALL_FRAMES) if images else None
    if root is not None and source == GENERATED:
        assert frames is None or isinstance(frames, Images)
        _copy(str(root), experiments, frames, Path(config.data_dir))
    if frames is None:
        generation.ensure(experiments, workers=workers)
    else:
        frames.ensure(workers=workers)
    return ExperimentDataset(experiments, split=split, frames=frames, modalities=images)


def _copy(root: str, experiments: ExperimentSet, frames: Images | None, data_dir: Path) -> None:
    """Copy a generated dataset, and its images if they are needed and there."""
    if (experiments if frames is None else frames.best_available()).is_finished():
        return
    data_dir.mkdir(parents=True, exist_ok=True)
    with opened(root, data_dir) as files:
        generation.make(experiments, workers=1, files=files)
        if frames is not None and (images := frames.best_available(files)) in files:
            generation.make(images, workers=1, files=files)


def _quoted(path: str | Path) -> str:
    escaped = str(path).replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def load_predictor(checkpoint: str | Path, *, model_class: type[nn.Module] | None = None) -> TrainedPredictor:
    """Return a trained predictor: a function from a batch of experiments to predictions of D.

    Args:
        checkpoint: A checkpoint of train.py, for example outputs/…/checkpoints/best.ckpt. Reading it runs no code in it.
        model_class: The class of a model of your own. Its arguments and weights come from the checkpoint; its code runs.

    Raises:
        CophyError: The file is something else, or of another class, or its predictor needs the true confounders.
    """
    return TrainedPredictor(Path(checkpoint), SCENARIOS, model_class)
