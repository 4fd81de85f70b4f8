"""How large gradients are."""

import lightning as L
from torch.nn.utils import get_total_norm
from torch.optim import Optimizer


class GradientNorm(L.Callback):
    """Logs the norm of all gradients together before they are clipped, averaged over the steps of an epoch."""

    def on_before_optimizer_step(self, trainer: L.Trainer, pl_module: L.LightningModule, optimizer: Optimizer) -> None:
        norm = get_total_norm([each.grad for each in pl_module.parameters() if each.grad is not None])
        pl_module.log("train/gradient_norm", norm, on_step=False, on_epoch=True, batch_size=1, sync_dist=True)
