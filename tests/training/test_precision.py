"""A network trains in every precision that the Trainer offers on a CPU."""

import warnings

import lightning as L
import pytest
import torch
from torch.utils.data import DataLoader

from cophy.dataset.datamodules import CounterfactualDataset
from cophy.types import Batch
from tests.models.networks import build
from tests.training.test_prediction_module import module_of

DTYPES = {"32-true": torch.float32, "64-true": torch.float64, "bf16-mixed": torch.float32, "16-mixed": torch.float32}


def loader(batch: Batch) -> DataLoader[Batch]:
    return CounterfactualDataset(batch).in_order(16)


@pytest.mark.parametrize("precision", DTYPES)
@pytest.mark.parametrize("choice", ["cophynet", "single_step", "mlp", "npe"])
def test_a_network_trains_in_every_precision(choice: str, precision: str, tower_batch: Batch, tmp_path) -> None:
    module = module_of(build(choice, **{"num_frames": 30} if choice == "single_step" else {}))
    before = [parameter.clone() for parameter in module.parameters()]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "You passed .*16-mixed.*")  # a CPU takes bf16 instead
        warnings.filterwarnings("ignore", ".*does not have many workers.*")
        trainer = L.Trainer(
            max_epochs=2, precision=precision, accelerator="cpu", logger=False, enable_checkpointing=False,
            enable_progress_bar=False, enable_model_summary=False, default_root_dir=tmp_path,
        )  # fmt: skip
        trainer.fit(module, loader(tower_batch), loader(tower_batch))
    assert torch.isfinite(trainer.callback_metrics["val/mse"])
    for parameter, old in zip(module.parameters(), before, strict=True):
        assert parameter.dtype == DTYPES[precision]
        assert not torch.equal(parameter, old.to(parameter.dtype))
