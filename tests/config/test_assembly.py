"""What a run is assembled of."""

from pathlib import Path

import pytest

from tests.commands import train


@pytest.mark.parametrize("positions", ["derendered", "train_ground_truth_test_derendered"])
@pytest.mark.parametrize("key", ["object_type", "pose"])
def test_looks_that_no_derenderer_estimates_are_refused_in_one_line(
    key: str, positions: str, tmp_path: Path, tiny_data: Path
) -> None:
    printed = train(f"positions={positions}", f"model.{key}=true", f"hydra.run.dir={tmp_path}", data=tiny_data, code=1)
    assert "Traceback" not in printed
    expected = f"positions={positions} does not go with model.{key}=true: no de-renderer estimates it"
    assert printed.strip().splitlines()[-1].endswith(expected)


@pytest.mark.parametrize("model", ["copy_b", "oracle_feedforward", "derenderer"])
def test_what_sees_no_looks_has_no_key_for_them(model: str, tmp_path: Path, tiny_data: Path) -> None:
    printed = train(f"model={model}", "model.pose=true", f"hydra.run.dir={tmp_path}", data=tiny_data, code=1)
    assert "Key 'pose' not in" in printed
