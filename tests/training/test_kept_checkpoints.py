"""The checkpoints of the repository: the current code loads them, and they are better than copy C."""

from pathlib import Path

import pytest
from torch.utils.data import DataLoader

import cophy
from cophy.errors import CophyError
from tests.conftest import ROOT, quick_first

FOLDER = ROOT / "checkpoints"
KEPT = sorted(path for path in FOLDER.glob("*.ckpt") if not path.stem.endswith("derenderer"))
SUPERVISED = [path for path in KEPT if path.stem.endswith("in_sup")]  # the true confounders


ONE_PER_SCENARIO = [FOLDER / f"{name}_cophynet.ckpt" for name in ("balls_4to4", "blocktower_3to3", "collision_all")]
OTHERS = [path for path in KEPT if path not in (*SUPERVISED, *ONE_PER_SCENARIO)]


@pytest.mark.parametrize("checkpoint", quick_first([*ONE_PER_SCENARIO, *OTHERS], 3), ids=lambda path: path.stem)
def test_a_checkpoint_is_better_than_copy_c(checkpoint: Path, tiny_data: Path) -> None:
    predictor = cophy.load_predictor(checkpoint)
    experiments = cophy.load(predictor.scenario.name, size="tiny", split=None, data_dir=str(tiny_data))
    (batch,) = DataLoader(experiments, batch_size=len(experiments))
    frames = batch["states"][:, 1, :: predictor.scenario.clock.states_per_frame, :, :3]
    c, d = frames[:, :1], frames[:, 1:]
    present = batch["presence"][:, 1, None, :, None]
    copy_error, predictor_error = ((guess - d).square().mul(present).sum() for guess in (c, predictor(batch)))
    assert predictor_error < 0.8 * copy_error


@pytest.mark.parametrize("checkpoint", SUPERVISED, ids=lambda path: path.stem)
def test_a_predictor_that_needs_true_confounders_is_refused(checkpoint: Path) -> None:
    with pytest.raises(CophyError, match="needs the true confounders, which no image shows"):
        cophy.load_predictor(checkpoint)
