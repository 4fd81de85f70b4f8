"""De-renderers from checkpoints, and the one that a run needs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cophy.errors import CophyError
from cophy.training.trained import TARGET, TrainedDerenderer, find_derenderer
from tests.training.trained.saved import NONSENSE, model_of, saved, weights_of

SAYS = r"a\.ckpt is no checkpoint of train\.py, or of another version of cophy \("
RENDER = {"modalities": ["rgb"], "resolution": 16, "backend": "tiny"}
IMAGE = np.zeros((1, 16, 16, 3), np.uint8)


def small() -> dict[str, Any]:
    return model_of("model=derenderer", "model.resolution=16", "model.width=2", "render.resolution=16")


def test_without_a_derenderer_the_error_says_how_to_get_one(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"no de-renderer of balls with 4 objects .* model=derenderer scenario=balls"):
        find_derenderer(tmp_path, "balls", {4}, "4to4")


def test_what_is_no_checkpoint_is_refused_without_running_it(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"no\.ckpt is no file"):
        TrainedDerenderer(tmp_path / "no.ckpt")
    (tmp_path / "bad.ckpt").write_bytes(b"cos\nsystem\n(S'touch hacked'\ntR.")
    with pytest.raises(CophyError, match=r"bad\.ckpt is no checkpoint"):
        TrainedDerenderer(tmp_path / "bad.ckpt")
    assert not (tmp_path / "hacked").exists()


def test_a_checkpoint_brings_what_the_derenderer_knows(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.ckpt", small(), weights_of(small()), num_objects=[3, 4])
    derenderer = TrainedDerenderer(path)
    assert (derenderer.scenario, derenderer.num_objects) == ("balls", {3, 4})
    position, logit = derenderer(IMAGE)
    assert position.shape == (*logit.shape, 3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        *NONSENSE[:1],
        *NONSENSE[2:],
        ({"split": {"name": "4to4", "test": {"num_objects": 4}}}, "a key is missing: 'train'"),
        ({"num_objects": ["many"]}, "invalid literal for int"),
        ({"size": {"name": "tiny"}}, "a key is missing: 'num_experiments'"),
        ({"model": {"_target_": TARGET, "slots": 4}}, "'int' object is not iterable"),
        ({"trained_on": []}, "list index out of range"),
        ({"render": RENDER | {"backend": "paper"}}, "'paper' is not a valid Backend"),
        ({"render": {}}, "a key is missing: 'modalities'"),
        ({"render": RENDER | {"resolution": 10**9}}, "render.resolution=1000000000 must be between"),
    ],
)
def test_an_origin_that_says_nonsense_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = saved(tmp_path / "a.ckpt", small(), {}, **changes)
    with pytest.raises(CophyError, match=SAYS + ".*" + message):
        TrainedDerenderer(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 4}, r"features\.0\.\d\.\w+ does not fit cophy\.models\.derenderer\.Derenderer as it is now"),
        ({"width": 10**6}, "model.width=1000000 is more than 16384"),
        ({"resolution": 6}, "resolution=6 is no multiple of 4"),
    ],
)
def test_weights_of_another_network_are_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = saved(tmp_path / "a.ckpt", small() | changes, weights_of(small()))
    with pytest.raises(CophyError, match=SAYS + ".*" + message):
        TrainedDerenderer(path)(IMAGE)
