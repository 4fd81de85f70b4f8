"""The two stages a row can be of: de-renderer (images -> positions) and predictor (positions of AB, and C -> D)."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
from torch import nn

from cophy.config import TrainConfig
from cophy.dataset.datamodule import CounterfactualDataModule
from cophy.dataset.frames import FrameDataModule
from cophy.dataset.oracles import OracleSettings
from cophy.errors import CophyError
from cophy.models.derenderer import Derenderer
from cophy.models.oracles import Oracle
from cophy.training.augmentation import symmetries_for
from cophy.training.callbacks import DerenderingFigures, PredictionFigures
from cophy.training.derenderers import TrainedDerenderer, find
from cophy.training.derendering import DerenderingModule
from cophy.training.evaluation import evaluate
from cophy.training.prediction import PredictionModule
from cophy.training.probe import estimate, probe
from cophy.training.row import Row

# positions= -> the splits of which a predictor sees estimates only
ESTIMATED: dict[str, tuple[str, ...]] = {
    "ground_truth": (),
    "derendered": ("train", "val", "test"),
    "train_ground_truth_test_derendered": ("test",),  # the paper's headline setting
}


@dataclass(frozen=True)
class Stage:
    """Data and module of a row. derenderer: name of the one whose estimates are seen. results: after a test, every measure
    per test item, and the twin pair that each item is of.
    """

    data: CounterfactualDataModule | FrameDataModule
    module: PredictionModule | DerenderingModule
    derenderer: str | None
    figures: L.Callback
    results: Callable[[], tuple[dict[str, np.ndarray], np.ndarray]]


def stage(network: nn.Module, settings: TrainConfig, row: Row, resolved: dict[str, Any]) -> Stage:
    """The stage that a network belongs to."""
    if isinstance(network, Derenderer):
        return _derendering(network, settings, resolved)
    return _prediction(network, settings, row, resolved)


def derenderer_for(settings: TrainConfig, row: Row) -> TrainedDerenderer:
    """The de-renderer that `derenderer` names, or the one among the runs beside the row that fits."""
    objects = {settings.split.train.num_objects, settings.split.test.num_objects}
    if settings.derenderer is not None:
        derenderer = TrainedDerenderer(Path(settings.derenderer))
    elif row.root is not None:
        derenderer = find(row.root, row.scenario, objects, row.split)
    else:
        raise CophyError(f"positions={settings.positions}: name the checkpoint of a de-renderer with derenderer=")
    derenderer.check(
        [
            settings.source.states(
                settings.scenario, count, split=settings.split, size=settings.size, seed=settings.data_seed,
                data_dir=Path(settings.data_dir),
            )
            for count in objects
        ]
    )  # fmt: skip
    return derenderer


def _derendering(network: Derenderer, settings: TrainConfig, resolved: dict[str, Any]) -> Stage:
    if "rgb" not in settings.render.modalities:
        raise CophyError("a de-renderer sees RGB: use render=rgb or render=all")
    data = FrameDataModule(
        scenario=settings.scenario,
        split=settings.split,
        num_objects=settings.num_objects,
        size=settings.size,
        seed=settings.data_seed,
        data_dir=Path(settings.data_dir),
        source=settings.source,
        render=settings.render,
        resolution=network.resolution,
        num_frames=settings.num_frames,
        batch_size=settings.training.batch_size,
        workers=settings.workers,
    )
    module = DerenderingModule(network, settings.training, config=resolved)
    return Stage(
        data,
        module,
        None,
        DerenderingFigures(settings.figures_every_n_epochs),
        lambda: (module.tested, data.test.pairs),
    )


def _prediction(network: nn.Module, settings: TrainConfig, row: Row, resolved: dict[str, Any]) -> Stage:
    if settings.training.confounder_weight and "train" in ESTIMATED[settings.positions]:
        raise CophyError(
            f"positions={settings.positions} does not go with training.confounder_weight: confounders are of true objects"
        )
    oracle = (network.oracle, OracleSettings(network.draws, network.noise)) if isinstance(network, Oracle) else None
    if oracle and settings.positions != "ground_truth":
        raise CophyError(f"positions={settings.positions}: oracles simulate, from true positions only")
    derenderer = derenderer_for(settings, row) if ESTIMATED[settings.positions] else None
    data = CounterfactualDataModule(
        scenario=settings.scenario,
        split=settings.split,
        size=settings.size,
        seed=settings.data_seed,
        data_dir=Path(settings.data_dir),
        source=settings.source,
        batch_size=settings.training.batch_size,
        workers=settings.workers,
        derenderer=derenderer,
        estimated=ESTIMATED[settings.positions],
        oracle=oracle,
        needs_confounders=settings.training.confounder_weight > 0
        or resolved["model"].get("confounders") == "ground_truth",
    )
    turns = symmetries_for(settings.split.train, settings.scenario)
    symmetries = turns if settings.training.augmentation else turns[:1]
    module = PredictionModule(network, settings.training, settings.scenario, symmetries, config=resolved)

    def results() -> tuple[dict[str, np.ndarray], np.ndarray]:
        prediction, batch = module.tested
        values = evaluate(prediction, batch, settings.scenario)
        probed = data.knows_confounders and not ESTIMATED[settings.positions]
        if prediction.confounder_estimate is not None and probed:
            fitted = estimate(network, data.train.batch, batch_size=settings.training.batch_size)
            assert fitted is not None
            values |= probe((fitted, data.train.batch), (prediction.confounder_estimate, batch))
        row.write_predictions(prediction, batch)
        return values, data.test_pairs

    seen = derenderer.name if derenderer else None
    return Stage(data, module, seen, PredictionFigures(settings.figures_every_n_epochs), results)
