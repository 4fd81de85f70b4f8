"""Every configuration composes, ablations change what they declare, mistakes are answered in one line."""

import itertools
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from cophy.report.tables import PaperTable, paper_tables
from tests.conftest import ROOT, SCENARIOS, composed, settings

ABLATIONS = {
    "full": set(),
    "static_gating": {"model.gating"},
    "mlp": {"model.interaction", "model.slots"},
    "single_step": {"model.decoding", "model.num_frames"},
    "feedforward": {"model.confounders"},
    "gt_confounders": {"model.confounders"},
    "supervised_confounders": {"training.confounder_weight"},
}


def leaves(tree: dict, prefix: str = "") -> dict[str, object]:
    found: dict[str, object] = {}
    for key, value in tree.items():
        found |= leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return found


def flat(*overrides: str) -> dict[str, object]:
    return leaves(OmegaConf.to_container(composed("train", *overrides)))


def test_every_ablation_file_is_listed_here() -> None:
    assert {path.stem for path in (ROOT / "conf" / "ablation").iterdir()} == set(ABLATIONS)


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_an_ablation_changes_exactly_its_own_keys(ablation: str) -> None:
    full, changed = flat("ablation=full"), flat(f"ablation={ablation}")
    assert {key for key in full | changed if full.get(key) != changed.get(key)} == ABLATIONS[ablation]


@pytest.mark.parametrize("ablation", ABLATIONS)
@pytest.mark.parametrize("name", SCENARIOS)
def test_every_ablation_composes_for_every_scenario(name: str, ablation: str) -> None:
    assert settings("train", f"scenario={name}", f"ablation={ablation}").scenario.name == name


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenarios_default_split_is_its_first(name: str) -> None:
    chosen = settings("train", f"scenario={name}")
    assert chosen.split.name == chosen.scenario.task.splits[0]


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_split_of_a_scenario_exists_under_its_own_name(name: str) -> None:
    scenario = settings("train", f"scenario={name}").scenario
    for split in scenario.task.splits:
        chosen = settings("train", f"scenario={name}", f"split={split}").split
        assert chosen.name == split
        assert {chosen.train.num_objects, chosen.test.num_objects} <= set(scenario.num_objects)


def test_every_split_belongs_to_a_scenario() -> None:
    known = {split for name in SCENARIOS for split in settings("train", f"scenario={name}").scenario.task.splits}
    assert {path.stem for path in (ROOT / "conf" / "split").iterdir()} == known


@pytest.mark.parametrize("group", ["scenario", "source_scenario", "model", "trainer"])
def test_every_number_in_conf_has_its_source(group: str) -> None:
    for path in (ROOT / "conf" / group).iterdir():
        for line in path.read_text().splitlines():
            value, _, source = re.sub('"[^"]*"', "", line).partition("#")
            if ":" in value and not value.lstrip().startswith("-") and re.search(r"\d", value.split(":", 1)[1]):
                assert source.strip(), f"{path.name}: {line}"


MISTAKES = {
    "scenario=ballz": "scenario=ballz does not exist (did you mean balls?); there are balls, blocktower, collision",
    "model.hidden_dim=abc": "model.hidden_dim: Value 'abc' of type 'str' could not be converted to Integer",
    "model.hiden_dim=32": "model.hiden_dim: Key 'hiden_dim' not in 'CoPhyNetConfig' (did you mean hidden_dim?)",
    "+model.hiden_dim=32": "unexpected keyword argument 'hiden_dim'",
    "model.gating=never": "model.gating",
    "trainer.max_epoch=3": "did you mean max_epochs?",
    "model.hidden_dim=0": "model: hidden_dim",
    "training.learning_rate=-1": "training: batch_size and learning_rate must be positive",
    "positions=guessed": "positions=guessed is not among ground_truth",
    "scenario=collision split=3to4": "split=3to4 does not go with collision: use all, sphere_to_cylinder, cylinder_to_sphere",
    "model=copy_c ablation=static_gating": "ablation=static_gating does not go with this model: Key 'gating' not in 'CopyCConfig'",
    "model=in ablation=feedforward": "ablation=feedforward does not go with this model: Invalid value 'none'",
    "model=npe ablation=mlp": "ablation=mlp does not go with this model: Key 'interaction'",
    "model=in ablation=supervised_confounders": "needs a model that estimates confounders from AB, with an attribute",
    "model=npe model.radius=0": "model.radius=0.0 must be positive",
    "model.interaction=mlp": "model.interaction=mlp needs model.slots",
    "+table=colision": "table=colision does not exist (did you mean collision?)",
    "model._target_=os.system": "model._target_=os.system cannot be imported",
    "model._target_=mine.Net": "cannot be imported: no module mine (is its folder on PYTHONPATH?)",
    "model=mine": "(a folder of your own: --config-dir)",
    "model._target_=collections.Counter": "model._target_=collections.Counter is not a torch.nn.Module",
    "ckpt=nowhere.ckpt": "ckpt=nowhere.ckpt is no file",
    f"ckpt={ROOT}/README.md": "is no checkpoint of train.py, or a damaged one",
    "trainer.max_epochs=0": "trainer.max_epochs=0 must be positive",
    "seed=0 data_seed=-1": "data_seed=-1 must be at least 0",
    "scenario.confounders.mass=[1] scenario.confounders.friction=[1] scenario=balls": "too few configurations for twins",
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_answered_in_one_line(mistake: str, tmp_path: Path, tiny_data: Path) -> None:
    command = [
        sys.executable,
        str(ROOT / "src" / "train.py"),
        "size=tiny",
        f"data_dir={tiny_data}",
        f"hydra.run.dir={tmp_path}",
    ]
    result = subprocess.run([*command, *mistake.split()], capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 1
    assert MISTAKES[mistake] in result.stderr
    assert "Traceback" not in result.stderr
    assert len(result.stderr.strip().splitlines()[-1]) < 400


def test_an_ablation_without_its_first_line_is_told_so(tmp_path: Path) -> None:
    (tmp_path / "ablation").mkdir()
    (tmp_path / "ablation" / "narrow.yaml").write_text("model: {hidden_dim: 8}\n")
    command = [sys.executable, str(ROOT / "src" / "train.py"), "--config-dir", str(tmp_path), "ablation=narrow"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, cwd=tmp_path)
    assert result.returncode == 1
    assert "ablation=narrow: its YAML must start with the line '# @package _global_'" in result.stderr


def test_a_misspelt_ablation_stops_before_the_first_job(tmp_path: Path) -> None:
    """A typo inside a row must not run as the baseline."""
    rows = tmp_path / "ablation"
    rows.mkdir()
    (rows / "typo.yaml").write_text("# @package _global_\nmodel: {gatting: static}\n")
    command = [
        sys.executable,
        str(ROOT / "src" / "train.py"),
        "-m",
        f"hydra.searchpath=[file://{tmp_path}]",
        "ablation=full,typo",
    ]
    result = subprocess.run(
        [*command, f"hydra.sweep.dir={tmp_path}/out"], capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 1
    assert "gatting" in result.stderr
    assert not list(tmp_path.rglob("metrics.json"))


@pytest.mark.parametrize("table", paper_tables(), ids=lambda table: table.id)
def test_the_sweep_of_a_table_runs_what_its_cells_show(table: PaperTable) -> None:
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        params = compose("train", [f"+table={table.id}"], return_hydra_config=True).hydra.sweeper.params
    swept = set()
    for values in itertools.product(*(str(value).split(",") for value in params.values())):
        # in the order in which Hydra gives them to a job: what is swept comes before the command line
        overrides = [*(f"{key}={value}" for key, value in zip(params, values, strict=True)), f"+table={table.id}"]
        with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
            cfg = compose("train", overrides, return_hydra_config=True)
        choices = cfg.hydra.runtime.choices
        swept.add((*(choices[group] for group in ("scenario", "split", "model", "ablation")), cfg.positions))
    cells = [
        {"positions": "ground_truth", **table.select, **row, **column}
        for row, column in itertools.product(table.rows.values(), table.columns.values())
    ]
    names = ("scenario", "split", "model", "ablation", "positions")
    shown = {tuple(cell[name] for name in names) for cell in cells}
    assert shown <= swept
    assert {model for _, _, model, _, _ in swept - shown} <= {"copy_c", "copy_b"}  # what costs no training


def test_every_table_has_a_sweep() -> None:
    assert {path.stem for path in (ROOT / "conf" / "table").iterdir()} == {table.id for table in paper_tables()}
