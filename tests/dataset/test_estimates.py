"""Estimates belong to the states and the images next to them."""

from pathlib import Path

import numpy as np
import pytest

from cophy.dataset import generation
from cophy.dataset.estimates import Estimates
from cophy.dataset.experiment_set import ALL_FRAMES, TEST_INPUTS
from cophy.dataset.images import Images
from cophy.errors import CophyError
from tests.dataset.copies import RENDER, MeanColor, copy_images, empty


def test_estimates_of_other_pictures_are_made_again(
    rendered: Images, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copied = copy_images(rendered, tmp_path)
    estimates = Estimates(copied.states, MeanColor())
    generation.make(estimates, workers=1)
    copied.directory.joinpath("manifest.json").write_text(
        rendered.directory.joinpath("manifest.json").read_text().replace(copied.checksums()["shard-00001.h5"], "0" * 64)
    )
    with pytest.raises(CophyError, match=r"shard-00001\.h5 is damaged \(it belongs to other data: its images_sha256"):
        estimates.load()
    empty(copied.directory)
    assert estimates.load()["position"].shape == (12, 2, 15, 4, 3)  # pictures may go once they were seen


def test_estimates_of_a_set_with_more_pictures_are_not_compared_with_others(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    estimates = Estimates(copied.states, MeanColor(), TEST_INPUTS)
    generation.make(estimates, workers=1)
    empty(copied.directory)
    generation.make(copied.states.frames(RENDER, TEST_INPUTS), workers=1)  # drawn later, for somebody else
    assert estimates.load()["position"].shape == (12, 2, 15, 4, 3)


def test_estimates_of_some_frames_are_those_of_all(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    every, few = (Estimates(copied.states, MeanColor(), needed) for needed in (ALL_FRAMES, TEST_INPUTS))
    generation.make(few, workers=1)
    assert every.best_available().directory == every.directory
    generation.make(every, workers=1)
    needed = TEST_INPUTS.mask(copied.states.load()["split"], 0, 15)
    for name, found in few.load().items():
        np.testing.assert_array_equal(found[needed], every.load()[name][needed])
        assert not found[~needed].any()
    empty(few.directory)
    assert few.best_available().directory == every.directory
