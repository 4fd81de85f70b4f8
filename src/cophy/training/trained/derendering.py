"""What a trained de-renderer sees in every frame of a dataset, kept beside it."""

from collections.abc import Sequence

from cophy.dataset import generation
from cophy.dataset.store.estimates import Estimates
from cophy.dataset.store.experiment_set import ExperimentSet
from cophy.training.trained.trained_derenderer import TrainedDerenderer


def derender(sets: Sequence[ExperimentSet], derenderer: TrainedDerenderer, *, workers: int) -> None:
    """Estimate positions and presence; what is missing is generated and rendered first.

    Args:
        sets: The datasets; ones that the de-renderer was not trained for are refused.
        derenderer: Looks at their frames.
        workers: Processes.
    """
    derenderer.check(sets)
    for experiments in sets:
        frames = experiments.frames(derenderer.render)
        estimates = Estimates(frames, derenderer)
        estimates.ensure(workers=workers)
        generation.make(estimates, workers=workers)
