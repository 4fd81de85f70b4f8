"""The data from Python."""

import os
import pickle
from pathlib import Path

import h5py
import hydra
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import cophy
from cophy.dataset.splits import SPLITS
from cophy.dataset.states import States
from cophy.errors import CophyError
from tests.commands import python
from tests.conftest import SCENARIOS, tiny_spec
from tests.released.indexing import LISTS
from tests.released.trees import CoPhyTree


@pytest.mark.parametrize("name", SCENARIOS)
def test_items_are_what_is_stored(name: str, tiny_data: Path) -> None:
    stored = States(tiny_spec(name), tiny_data).load()
    for split in (*SPLITS, None):
        data = cophy.load(name, size="tiny", split=split, data_dir=tiny_data)
        rows = (
            np.arange(len(stored["split"])) if split is None else np.flatnonzero(stored["split"] == SPLITS.index(split))
        )
        assert len(data) == len(rows) > 0
        assert f"{len(rows)} experiments of {name}, " in repr(data)
        assert "mass (" in repr(data)
        for item in (0, len(data) - 1):
            assert data[item].keys() == stored.keys()
            for field, value in data[item].items():
                np.testing.assert_array_equal(value.numpy(), stored[field][rows[item]])


@pytest.mark.slow
def test_images_are_read_on_access_by_any_process(tiny_data: Path) -> None:
    data = cophy.load(
        "collision",
        size="tiny",
        split="test",
        modalities=("states", "rgb", "depth"),
        resolution=16,
        data_dir=str(tiny_data),
    )
    first = data[0]
    assert "segmentation" not in first
    spec = tiny_spec("collision")
    shard, place = divmod(data.rows[0], len(spec.experiments_of_shard(0)))
    (path,) = States(spec, tiny_data).directory.glob(f"images-16-*/shard-{shard:05}.h5")
    with h5py.File(path) as stored:
        np.testing.assert_array_equal(first["rgb"], stored["rgb"][place])
        np.testing.assert_array_equal(first["depth"], stored["depth"][place])
    assert (pickle.loads(pickle.dumps(data))[0]["rgb"] == first["rgb"]).all()
    (batch,) = DataLoader(data, batch_size=len(data), num_workers=2)
    assert batch["rgb"].shape == (len(data), *first["rgb"].shape)
    assert batch["depth"].dtype is torch.int32
    assert (batch["rgb"][0] == first["rgb"]).all()


def test_released_data_are_read_alike(tmp_path: Path) -> None:
    root = tmp_path / "it's here"  # a path that Hydra's grammar would not take as it is
    tree = CoPhyTree(root)
    for name in "0123":
        tree.balls(name)
    tree.lists("ballsCF", "_4", **LISTS)
    asked = {"source": "cophy", "root": str(root), "data_dir": str(tmp_path / "data"), "modalities": ("rgb",)}
    data = cophy.load("balls", split="train", **asked)
    assert len(data) == len(LISTS["train"])
    assert data[0]["rgb"].shape == (2, 30, 32, 32, 3)
    stored = np.load(root / "ballsCF" / "4" / "0" / "ab" / "states.npy")
    np.testing.assert_array_equal(data[0]["states"][0], stored.astype("<f4"))
    (root / "ballsCF" / "4" / "1" / "cd" / "rgb.mp4").unlink()
    with pytest.raises(CophyError, match=r"rgb\.mp4"):
        cophy.load("balls", split="train", **asked)[1]
    with pytest.raises(CophyError, match="no depth"):
        cophy.load("balls", split="test", **{**asked, "modalities": ("depth",)})[0]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"split": "testing"}, "there are train, val, test"),
        ({"modalities": "rgb"}, r"a tuple of names, as \('rgb',\)"),
        ({"modalities": ("colour",)}, "there are states, rgb"),
        ({"num_objects": 9}, "num_objects=9: scenario=balls has 2, 3, 4, 5, 6 in size=tiny$"),
        (
            {"size": "12k", "scenario": "blocktower", "num_objects": 4},
            "num_objects=4: scenario=blocktower has 3 in size=12k$",
        ),
        ({"size": 640}, "size=640 does not exist; there are 12k, paper, sample, small, tiny$"),
        ({"scenario": "ball"}, r"did you mean balls\?\); there are balls, blocktower, collision$"),
        ({"source": "cophy"}, "needs source.root="),
        ({"resolution": 3}, "between 16 and 4096"),
    ],
)
def test_mistakes_are_named_before_anything_is_generated(wrong: dict, said: str, tmp_path: Path) -> None:
    asked = {"scenario": "balls", "size": "tiny", "data_dir": str(tmp_path), "modalities": ("rgb",), **wrong}
    with pytest.raises(CophyError, match=said):
        cophy.load(**asked)
    assert not list(tmp_path.iterdir())


PROGRAM = """
import cophy, hydra

@hydra.main(version_base="1.3", config_path=".", config_name="train")
def main(cfg):
    print(cfg, len(cophy.load("balls", size="tiny", data_dir=cfg.data)), cfg == hydra.compose("train", ["data=" + cfg.data]))

if __name__ == "__main__":
    main()
"""


@pytest.mark.slow
def test_a_hydra_program_of_somebody_else_loads_data_and_continues(tiny_data: Path, tmp_path: Path) -> None:
    """Its configuration has the name of one of ours."""
    (tmp_path / "train.yaml").write_text("data: here")
    (tmp_path / "program.py").write_text(PROGRAM)
    done = python(tmp_path / "program.py", f"data={tiny_data}", f"hydra.run.dir={tmp_path / 'run'}")
    assert done.stdout.split()[-2:] == ["34", "True"]
    with hydra.initialize_config_dir(str(tmp_path), version_base="1.3"):
        cophy.load("balls", size="tiny", data_dir=tiny_data)
        assert hydra.compose("train").data == "here"


def test_a_resolution_of_released_clips_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match="resolution=112: released clips have their own"):
        cophy.load("balls", source="cophy", root=tmp_path, modalities=("rgb",), resolution=112, data_dir=tmp_path)


@pytest.mark.slow
def test_a_program_on_standard_input_generates_data(tmp_path: Path) -> None:
    code = 'import cophy\nprint(len(cophy.load("collision", size="tiny")))\n'
    done = python("-", cwd=tmp_path, env={"COPHY_DATA": "here"}, input=code)
    assert done.stdout == "34\n"
    assert [path.name for path in tmp_path.iterdir()] == ["here"]


def test_data_are_where_the_environment_says(tiny_data: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COPHY_DATA", os.path.relpath(tiny_data))
    assert len(cophy.load("balls", size="tiny")) == 34
    assert not list(tmp_path.iterdir())
