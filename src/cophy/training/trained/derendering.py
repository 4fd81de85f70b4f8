"""What a trained de-renderer sees in the frames of a dataset, kept beside it."""

from collections.abc import Sequence

from cophy.dataset import generation
from cophy.dataset.pictures.estimates import Estimates
from cophy.dataset.pictures.images import Images
from cophy.dataset.pictures.needed_frames import NeededFrames
from cophy.dataset.store.experiment_set import ExperimentSet
from cophy.dataset.store.shardset import ShardSet
from cophy.errors import CophyError
from cophy.training.trained.trained_derenderer import TrainedDerenderer


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
