"""Estimates are of the states and the pictures beside them."""

from pathlib import Path

import pytest

from cophy.dataset import generation
from cophy.dataset.estimates import Estimates
from cophy.dataset.experiment_set import TEST_INPUTS
from cophy.dataset.images import Images
from cophy.errors import CophyError
from tests.dataset.pictures.guess import Guess
from tests.dataset.pictures.rendered import RENDER, copy_images


def test_estimates_of_other_pictures_are_made_again(
    rendered: Images, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copied = copy_images(rendered, tmp_path)
    estimates = Estimates(copied.states, Guess())
    generation.make(estimates, workers=1)
    copied.directory.joinpath("manifest.json").write_text(
        rendered.directory.joinpath("manifest.json").read_text().replace(copied.checksums()["shard-00001.h5"], "0" * 64)
    )
    with pytest.raises(CophyError, match=r"shard-00001\.h5 is damaged \(it was made from other files"):
        estimates.load()
    for path in copied.directory.glob("*"):
        path.unlink()
    assert estimates.load()["position"].shape == (48, 2, 15, 4, 3)  # pictures may go once they were seen


def test_estimates_of_a_set_with_more_pictures_are_not_compared_with_others(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    estimates = Estimates(copied.states, Guess(), TEST_INPUTS)
    generation.make(estimates, workers=1)
    for path in copied.directory.iterdir():
        path.unlink()
    generation.make(copied.states.frames(RENDER, TEST_INPUTS), workers=1)  # drawn later, for somebody else
    assert estimates.load()["position"].shape == (48, 2, 15, 4, 3)
