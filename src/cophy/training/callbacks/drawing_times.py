"""When figures are drawn, and where they go."""

import lightning as L
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.trainer.states import TrainerFn
from torch.utils.tensorboard import SummaryWriter


def writer_now(trainer: L.Trainer, every_n_epochs: int) -> SummaryWriter | None:
    """TensorBoard's writer where this validation is drawn: every few epochs, after the last, and where nothing is trained.

    None where it is not drawn, on all devices but the first, and where TensorBoard is not among the loggers.

    Args:
        trainer: Has just validated.
        every_n_epochs: How often is drawn.
    """
    logger = next((logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)), None)
    if logger is None or trainer.sanity_checking or not trainer.is_global_zero:
        return None
    epoch, trains = trainer.current_epoch + 1, trainer.state.fn == TrainerFn.FITTING
    return logger.experiment if not trains or epoch % every_n_epochs == 0 or epoch == trainer.max_epochs else None
