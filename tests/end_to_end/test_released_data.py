"""From a released tree to rows of a table, and errors that run nothing."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cophy.audit.released import audit_released
from cophy.config import settings
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.errors import CophyError
from tests.commands import run
from tests.commands import train as train_on_generated
from tests.released.indexing import make
from tests.released.trees import CoPhyTree

IDS = [str(number) for number in range(40)]
LISTS = {"train": IDS[:28], "val": IDS[28:36], "test": IDS[36:]}
SHORT = ("trainer.max_epochs=1", "trainer.enable_progress_bar=false", "figures_every_n_epochs=9")


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> CoPhyTree:
    """Towers of three, four balls and collisions, forty of each."""
    tree = CoPhyTree(tmp_path_factory.mktemp("released") / "CoPhy_224", clips=False)
    for name in IDS:
        tree.tower(name)
        tree.balls(name)
        tree.collision(name)
    for task, ending in (("blocktowerCF", "_3_normal"), ("ballsCF", "_4"), ("collisionCF", "_normal")):
        tree.lists(task, ending, **LISTS)
    return tree


def train(tree: CoPhyTree, out: Path, *arguments: str, code: int = 0) -> str:
    where = (f"source.root={tree.root}", f"data_dir={out / 'data'}", f"source.outputs={out / 'outputs'}")
    return run("train", "source=cophy", *where, *SHORT, *arguments, code=code)


def report(out: Path) -> str:
    run("report", "source=cophy", f"outputs={out / 'outputs'}", f"directory={out}", "data_dir=nowhere")
    return (out / "tables.md").read_text()


@pytest.mark.parametrize(
    "scenario",
    ["blocktower", pytest.param("balls", marks=pytest.mark.slow), pytest.param("collision", marks=pytest.mark.slow)],
)
def test_a_row_on_released_data_fills_its_own_table(tree: CoPhyTree, tmp_path: Path, scenario: str) -> None:
    train(tree, tmp_path, f"scenario={scenario}")
    (path,) = (tmp_path / "outputs").rglob("metrics.json")
    content = json.loads(path.read_text())
    assert (content["size"], content["num_train"], content["num_test"]) == ("cophy", 28, 4)
    assert content["dataset_ids"][0].startswith(
        {"blocktower": "3", "balls": "4", "collision": "2"}[scenario] + "-cophy-"
    )
    assert f"**{content['metrics']['mse']:.3f}**" in report(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("other", ["generated", "filtered_cophy"])
def test_a_row_on_released_data_fills_no_other_table(tree: CoPhyTree, tmp_path: Path, other: str) -> None:
    train(tree, tmp_path, "scenario=blocktower")
    run("report", f"source={other}", f"outputs={tmp_path / 'outputs'}", f"directory={tmp_path}", "data_dir=nowhere")
    markdown = (tmp_path / "tables.md").read_text()
    assert "blocktower, size cophy, true positions" in markdown
    assert "Table 2" not in markdown


def test_a_row_on_generated_data_fills_no_table_of_released_ones(tiny_data: Path, tmp_path: Path) -> None:
    train_on_generated("model=copy_c", f"source.outputs={tmp_path}", data=tiny_data)
    run("report", "source=cophy", f"outputs={tmp_path}", f"directory={tmp_path}", "data_dir=nowhere")
    markdown = (tmp_path / "tables.md").read_text()
    assert "size tiny, true positions" in markdown
    assert "Table 2" not in markdown


@pytest.mark.slow
def test_the_audit_of_released_data_ends_in_their_faults(tree: CoPhyTree, tmp_path: Path) -> None:
    where = ("source=cophy", f"source.root={tree.root}", f"data_dir={tmp_path}", "scenario=collision")
    failing = [line for line in run("audit", *where, code=1).splitlines() if line.startswith("audit: ")]
    assert any("share of mass" in line for line in failing)  # 5 and 1 throughout


def opened(tree: CoPhyTree, data_dir: Path, *overrides: str) -> Any:
    """The index that a training with these overrides reads."""
    config = settings("train", "source=cophy", f"source.root={tree.root}", *overrides)
    count = config.split.test.num_objects
    (experiments,) = config.source.experiment_sets(config.scenario, config.split, [count], data_dir)
    return experiments


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["source.root=null"], "source=cophy needs source.root="),
        (["source.root=/nowhere"], "in /nowhere/splits or /nowhere: put the released lists"),
        (["source.splits=/nowhere"], "there is no blocktowerCF_train_3_normal.txt in /nowhere"),
        (["split=3to4"], "blocktowerCF_train_4_normal.txt"),
        (["source=filtered_cophy"], "split=3to3 does not go with blocktower: use 4to4"),
    ],
)
def test_what_is_not_there_is_named(tree: CoPhyTree, tmp_path: Path, overrides: list[str], message: str) -> None:
    with pytest.raises(CophyError, match=re.escape(message)):
        opened(tree, tmp_path / "data", *overrides)
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("needed", [False, True])
def test_confounders_that_nobody_knows_are_not_given(tmp_path: Path, needed: bool) -> None:
    tree = CoPhyTree(tmp_path / "generated", clips=False)
    for name in IDS:
        tree.generated_tower(name)
    tree.lists("blocktowerCF", "_3_normal", **LISTS)
    released, config = make(opened(tree, tmp_path)), settings("train", "source=cophy")
    data = CounterfactualDataModule(
        config.split, train_set=released, test_set=released, batch_size=8, workers=1, needs_confounders=needed
    )
    data.prepare_data()
    if needed:
        with pytest.raises(CophyError, match="does not contain all true confounders"):
            data.setup()
    else:
        data.setup()
        assert not data.knows_confounders
        assert data.test.batch.targets.pair.tolist() == [36, 37, 38, 39]  # each its own, for the bootstrap


def test_the_audit_says_what_holds_and_what_does_not_apply(tree: CoPhyTree, tmp_path: Path) -> None:
    states = make(opened(tree, tmp_path, "scenario=balls"))
    arrays = states.load()
    assert {check.name for check in audit_released(arrays, states.spec) if not check.passed} <= {
        "share of mass", "share of friction", "share of restitution", "distances in CD per mass",
        "distances in CD per friction", "distances in CD per restitution",
    }  # fmt: skip
    assert sum(check.result.startswith("does not apply") for check in audit_released(arrays, states.spec)) == 4
    arrays["states"][1] = arrays["states"][39]
    arrays["presence"][1] = arrays["presence"][39]
    present = np.flatnonzero(arrays["presence"][2, 1])
    arrays["states"][2, 1, :, present, 1] += 0.01
    arrays["states"][3, 0, 5, :, 2] = 0.1
    failing = {check.name for check in audit_released(arrays, states.spec) if not check.passed}
    assert failing >= {
        "scenes that are in two splits", "C equals A except for one object", "objects are above the floor, lowest centre",
    }  # fmt: skip


@pytest.mark.parametrize(
    "kind", ["tower", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("balls", "collision"))]
)
def test_an_audit_of_three_experiments_audits_what_it_can(tmp_path: Path, kind: str) -> None:
    tree = CoPhyTree(tmp_path / "CoPhy_224", clips=False)
    for name in "012":
        getattr(tree, kind)(name)
    task, ending, scenario = {
        "tower": ("blocktowerCF", "_3_normal", "blocktower"),
        "balls": ("ballsCF", "_4", "balls"),
        "collision": ("collisionCF", "_normal", "collision"),
    }[kind]
    tree.lists(task, ending, train=["0"], val=["1"], test=["2"])
    where = ("source=cophy", f"source.root={tree.root}", f"data_dir={tmp_path / 'data'}", f"scenario={scenario}")
    assert "1 : 1 : 1" in run("audit", *where)


def test_an_empty_list_is_named(tmp_path: Path) -> None:
    tree = CoPhyTree(tmp_path / "CoPhy_224", clips=False)
    for name in "012":
        tree.balls(name)
    tree.lists("ballsCF", "_4", train=["0", "1"], val=[], test=["2"])
    printed = train(tree, tmp_path, "scenario=balls", code=1)
    assert "leaves no val experiments" in printed
    (listed,) = tree.root.rglob("*val*.txt")
    assert str(listed) in printed


def test_no_derenderer_learns_unknown_colors(tmp_path: Path) -> None:
    """The released generator of towers writes no colors.txt."""
    tree = CoPhyTree(tmp_path / "CoPhy_224", seed=1)
    for name in IDS[:6]:
        tree.generated_tower(name)
    tree.lists("blocktowerCF", "_3_normal", train=IDS[:4], val=IDS[4:5], test=IDS[5:6])
    printed = train(
        tree, tmp_path, "scenario=blocktower", "model=derenderer", "num_objects=[3]", "num_images=10", code=1
    )
    assert "in 6 of 6 experiments no colors.txt says which object has which colour" in printed
