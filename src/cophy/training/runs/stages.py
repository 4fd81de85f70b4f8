"""What a run trains and tests: a de-renderer (images -> positions) or a predictor (positions of AB, and C -> D)."""

from collections.abc import Callable
from dataclasses import dataclass

import lightning as L
from torch import nn

from cophy.dataset.feed.counterfactual_datamodule import CounterfactualDataModule
from cophy.dataset.feed.frame_datamodule import FrameDataModule
from cophy.models.derenderer import Derenderer
from cophy.training.augmentation import matrices_of
from cophy.training.callbacks.derendering_figures import DerenderingFigures
from cophy.training.callbacks.prediction_figures import PredictionFigures
from cophy.training.derendering_module import DerenderingModule
from cophy.training.measures.copies import mse_of_copies
from cophy.training.measures.evaluation import evaluate
from cophy.training.measures.probe import Probed, estimate, probe, warn_if_constant
from cophy.training.prediction_module import PredictionModule
from cophy.training.runs.identity import Run
from cophy.training.runs.results import Measured, write_predictions
from cophy.training.settings import Training


@dataclass(frozen=True)
class Stage:
    """Data and module of a run.

    Attributes:
        data: Datamodule, set up.
        module: What is trained and tested.
        figures: Callback that draws validation examples.
        measure: After a test: writes what was predicted, and measures it.
        derenderer: Name of the one whose estimates are seen, or None.
        epochs_factor: How many times as many epochs it is trained as `trainer.max_epochs` says.
    """

    data: CounterfactualDataModule | FrameDataModule
    module: PredictionModule | DerenderingModule
    figures: L.Callback
    measure: Callable[[], Measured]
    derenderer: str | None = None
    epochs_factor: int = 1

    @property
    def learns(self) -> bool:
        """Whether there is anything to train."""
        return any(parameter.requires_grad for parameter in self.module.network.parameters())


def derendering_stage(
    network: Derenderer, data: FrameDataModule, training: Training, *, figures_every_n_epochs: int
) -> Stage:
    """Train a de-renderer on single frames (paper, appendix).

    Args:
        network: Learns positions in units of their spread over the training frames, which is set here.
        data: Set up.
        training: How it is optimised.
        figures_every_n_epochs: How often figures are drawn.
    """
    network.scale_(*data.train.position_statistics())
    module = DerenderingModule(network, training)
    figures = DerenderingFigures(data.val, data.scenario, figures_every_n_epochs)
    return Stage(data, module, figures, lambda: Measured(module.tested, data.test.pairs))


def prediction_stage(
    network: nn.Module, data: CounterfactualDataModule, training: Training, run: Run, *, figures_every_n_epochs: int
) -> Stage:
    """Train a predictor of D (paper Sec. 4).

    Args:
        network: From `Inputs` to `Prediction`.
        data: Set up.
        training: How it is optimised.
        run: In whose directory the predictions go.
        figures_every_n_epochs: How often figures are drawn.
    """
    scenario = data.scenario
    augmentations = matrices_of(scenario, training.augmentation)
    module = PredictionModule(
        network, training, scenario, augmentations=augmentations, missed_position=data.mean_position, seed=data.seed
    )

    def measure() -> Measured:
        prediction, batch = module.tested
        values = evaluate(prediction, batch.targets, scenario)
        if prediction.confounder_estimate is not None:
            tested = Probed(prediction.confounder_estimate, batch.targets)
            warn_if_constant(tested)
            if data.knows_confounders and not data.estimated:
                train = data.train.batch
                fitted = estimate(network, train.inputs, batch_size=training.batch_size)
                assert fitted is not None
                values |= probe(Probed(fitted, train.targets), tested)
        write_predictions(run.directory, prediction, batch.targets)
        copies = mse_of_copies(batch, scenario, data.mean_position)
        return Measured(values, batch.targets.pair.numpy(), copies)

    figures = PredictionFigures(data.val.batch, scenario, figures_every_n_epochs)
    derenderer = data.derenderer.name if data.derenderer else None
    return Stage(data, module, figures, measure, derenderer, data.split.epochs_factor)
