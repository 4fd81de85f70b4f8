"""Configurations compose, ablations change only their own keys, and mistakes end with one line."""

import re
import runpy
import sys
from functools import cache
from pathlib import Path

import pytest
from omegaconf import OmegaConf

import cophy.models
from cophy.cli import explain, is_user_error
from cophy.config import composed, settings, to_config
from cophy.dataset.splits import Split
from cophy.errors import CophyError
from tests.commands import run
from tests.conftest import ROOT, SCENARIOS, cached_settings

ABLATIONS = {
    "full": set(),
    "static_gating": {"model.gating"},
    "mlp": {"model.interaction", "model.slots"},
    "single_step": {"model.decoding", "model.num_frames"},
    "feedforward": {"model.confounders"},
    "gt_confounders": {"model.confounders"},
    "gt_confounders_without_pose": {"model.confounders"},
    "supervised_confounders": {"training.confounder_weight"},
}


def leaves(tree: dict, prefix: str = "") -> dict[str, object]:
    values: dict[str, object] = {}
    for key, value in tree.items():
        values |= leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return values


@cache
def flat(*overrides: str) -> dict[str, object]:
    return leaves(OmegaConf.to_container(composed("train", *overrides)))


def test_every_ablation_file_is_listed_here() -> None:
    assert {path.stem for path in (ROOT / "conf" / "ablation").iterdir()} == set(ABLATIONS)


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_an_ablation_changes_exactly_its_own_keys(ablation: str) -> None:
    full, changed = flat("ablation=full"), flat(f"ablation={ablation}")
    assert {key for key in full | changed if full.get(key) != changed.get(key)} == ABLATIONS[ablation]


def test_every_split_has_its_own_name_and_belongs_to_a_scenario() -> None:
    """The default split of a scenario is its first; on half of the data, training takes twice the epochs."""
    known = set()
    for name in SCENARIOS:
        config = cached_settings("train", f"scenario={name}")
        splits = config.scenario.task.splits
        assert config.split.name == splits[0]
        known |= set(splits)
        for name_of_split in splits:
            keys = OmegaConf.load(ROOT / "conf" / "split" / f"{name_of_split}.yaml")
            del keys["defaults"]
            split = to_config(OmegaConf.merge(Split, keys), Split)
            assert split.name == name_of_split
            assert {split.train.num_objects, split.test.num_objects} <= set(config.scenario.num_objects)
            assert split.epochs_factor == (2 if split.train.configurations == "seen" else 1)
    assert {path.stem for path in (ROOT / "conf" / "split").iterdir()} == known


@pytest.mark.parametrize("group", ["scenario", "confounders", "source_scenario", "model", "trainer", "size"])
def test_every_number_in_conf_has_its_source(group: str) -> None:
    for path in (ROOT / "conf" / group).iterdir():
        for line in path.read_text().splitlines():
            value, _, source = re.sub('"[^"]*"', "", line).partition("#")
            if (
                ":" in value
                and not value.lstrip().startswith(("-", "name:"))
                and re.search(r"\d", value.split(":", 1)[1])
            ):
                assert source.strip(), f"{path.name}: {line}"


GRIDS = {
    "text": ([1, 10], [0.5, 1]),
    "released": ([1, 2, 5], [0.1, 0.5, 1]),
}


@pytest.mark.parametrize(
    ("command", "name", "grid"),
    [
        *(("train", "balls", "released"), ("export", "collision", "text")),
        *(("look", "collision", "released"), ("audit", "balls", "text")),
    ],
)
def test_every_command_on_data_accepts_either_grid_of_confounders(command: str, name: str, grid: str) -> None:
    needed = ["root=anywhere"] if command == "export" else []
    config = settings(command, f"scenario={name}", f"confounders={grid}", *needed).scenario.confounders
    assert (config.mass, config.friction) == GRIDS[grid]
    assert config.restitution == [0.1, 0.5, 1] if grid == "released" else len(config.restitution) == 1


@pytest.mark.parametrize(("name", "grid"), [("balls", "text"), ("collision", "released")])
def test_released_data_have_their_own_confounders_whatever_is_configured(name: str, grid: str) -> None:
    ours = settings("audit", f"scenario={name}", "confounders=released").scenario.confounders
    theirs = settings("audit", f"scenario={name}", f"confounders={grid}", "source=cophy").scenario.confounders
    assert theirs == ours
    filtered = settings("audit", f"scenario={name}", f"confounders={grid}", "source=filtered_cophy").scenario
    assert (filtered.confounders.mass, filtered.confounders.friction) == ([1, 10], [0.5])


def test_a_single_value_of_a_grid_can_be_set() -> None:
    overrides = ("scenario=balls", "confounders=released", "scenario.confounders.mass=[1,10]")
    grid = settings("generate", *overrides).scenario.confounders
    assert (grid.mass, grid.friction) == ([1, 10], [0.1, 0.5, 1])


@pytest.mark.slow
def test_a_sweep_goes_through_both_grids(tmp_path: Path) -> None:
    printed = run(
        "generate",
        "-m",
        "confounders=glob(*)",
        "scenario=balls",
        "size=tiny",
        f"data_dir={tmp_path}",
    )
    assert len(list((tmp_path / "balls").iterdir())) == 2, printed


def test_every_model_of_cophy_has_a_schema() -> None:
    """Directly, or through the model whose YAML it begins with."""

    def has_schema(path: Path) -> bool:
        (first, *_) = OmegaConf.load(path).defaults
        ((name, schema),) = first.items() if OmegaConf.is_dict(first) else [(first, None)]
        if schema is None:
            return path.with_name(f"{name.partition('@')[0].removeprefix('/model/')}.yaml").exists()
        return schema in {*cophy.models.__all__, "oracle"}

    assert [path.name for path in (ROOT / "conf" / "model").iterdir() if not has_schema(path)] == []


MISTAKES = {
    "scenario=ballz": "scenario=ballz does not exist (did you mean balls?); there are balls, blocktower, collision",
    "model.hidden_dim=abc": "model.hidden_dim: Value 'abc' of type 'str' could not be converted to Integer",
    "model.hiden_dim=32": "model.hiden_dim: Key 'hiden_dim' not in 'CoPhyNet' (did you mean hidden_dim?)",
    "+model.hiden_dim=32": "model.hiden_dim: there is no such key",
    "+trainer.max_epoch=3": "unexpected keyword argument 'max_epoch'",
    "optimized_metric=test/mse": "optimized_metric=test/mse must be a metric of the validation split",
    "model.gating=never": "model.gating",
    "trainer.max_epoch=3": "did you mean max_epochs?",
    "max_epochs=3": "(did you mean trainer.max_epochs?)",
    "learning_rat=1": "(did you mean training.learning_rate?)",
    "model.hidden_dim=0": "model.hidden_dim=0 must be at least 1",
    "training.learning_rate=-1": "training: batch_size and learning_rate must be positive",
    "training.position_noise=-1": "noise and weights not negative",
    "positions=guessed": "positions=guessed is not among ground_truth",
    "scenario=blocktower confounders=released": "confounders= does not go with this scenario, which has one grid; it goes with balls and collision",
    "num_objects=5": "num_objects=5 must be a list: 'num_objects=[5]'",
    "scenario.num_objects=[]": "scenario.num_objects=[] must be numbers from 1",
    "scenario=balls scenario.num_objects=[1,2]": "scenario.num_objects=[1, 2]: an experiment needs at least 2 balls",
    "scenario.num_objects=[2,3]": "scenario.num_objects=[2, 3]: one block is no tower, and remove_top in scenario.do_operations leaves no tower",
    "scenario=collision scenario.num_objects=[2,3]": "scenario.num_objects=[2, 3] must be [2]: one object hits the other",
    "scenario=balls scenario.arena_half_width=0.4": "scenario.arena_half_width=0.4 m leaves no place for a ball of 1 m",
    "scenario.camera.eye=[0,0,10] scenario.camera.target=[0,0,0]": "eye and target must be two points, x, y and z each, and not one above",
    "model=alongside trainer.precision=16-mixed": "trainer.precision=16-mixed: model=alongside needs unscaled losses, use bf16-mixed",
    "scenario.num_objects=[3,4,5]": "blocktower has 4 colours, and every object of an experiment needs its own: add '+scenario.colors.NAME=",
    "metrics.height=1 +metrics.x._target_=x": "Key 'height' is not in struct",
    "+metrics.height=1": "metrics.height is no block with a _target_: its YAML starts with the line '# @package metrics.<name>'",
    "+metrics.mse._target_=torch.dist": "metrics.mse: there is a metric or loss of this name; choose another name",
    "training.loss._target_=mine.loss": "Is its folder on PYTHONPATH?",
    "loss=huber +training.loss.width=1": "got an unexpected keyword argument 'width'",
    "model=derenderer loss=huber": "loss= is for predictors of D, and this model is a de-renderer",
    "model=derenderer training.num_experiments=50": "training.num_experiments= is for predictors of D",
    "model=copy_c ablation=static_gating": "ablation=static_gating does not go with this model: Key 'gating' not in 'CopyC'",
    "model=in ablation=feedforward": "ablation=feedforward does not go with this model: Invalid value 'none'",
    "model=npe ablation=mlp": "ablation=mlp does not go with this model: Key 'interaction'",
    "model=in ablation=supervised_confounders": "needs a model that estimates confounders from AB, with an attribute",
    "model=npe model.radius=0": "model.radius=0.0 must be positive",
    "model.interaction=mlp": "model.interaction=mlp needs model.slots",
    "+table=colision": "table=colision does not exist (did you mean collision?)",
    "model._target_=os.system": "model._target_=os.system is not a torch.nn.Module",
    "model._target_=mine.Net": "cannot be imported: no module mine (is its folder on PYTHONPATH?)",
    "model=mine": "(your own folder: --config-dir)",
    "model._target_=collections.Counter": "model._target_=collections.Counter is not a torch.nn.Module",
    "ckpt=nowhere.ckpt": "ckpt=nowhere.ckpt is not a file",
    f"ckpt={ROOT}/README.md": "is not a checkpoint of train.py, or is damaged",
    "predictor=nowhere.ckpt": "predictor=nowhere.ckpt is not a file: a run keeps best.ckpt",
    f"predictor={ROOT}/README.md": "is not a checkpoint of train.py, or is damaged",
    f"predictor={ROOT}/checkpoints/balls_4to4_in.ckpt": "belongs to another training (scenario=balls, size=small, ",
    "predictor=a.ckpt ckpt=b.ckpt": "give one of them",
    "predictor=a.ckpt model=oracle_feedforward": "predictor=a.ckpt: oracle_feedforward has nothing to train",
    "predictor=a.ckpt model=derenderer": "predictor=a.ckpt: this is for predictors of D, and model=derenderer is a de-renderer",
    "logger=wandb": "logger=wandb needs another package: ",
    "training.optimizer._target_=torch.optim.Adan": "Are you sure that 'Adan' is importable",
    "+training.schedule.factor=2": "cosine_to_zero() got an unexpected keyword argument 'factor'",
    "split.epochs_factor=0": "split: epochs_factor=0 must be at least 1",
    "trainer.max_epochs=0": "trainer.max_epochs=0 must be positive",
    "seed=0 data_seed=-1": "data_seed=-1 must be at least 0",
    "scenario.confounders.mass=[1] scenario.confounders.friction=[1] scenario=balls": "too few configurations for twins",
    "seed=99999999999": "seed=99999999999 must be from 0 to",
    "trainer.check_val_every_n_epoch=0": "trainer.check_val_every_n_epoch=0 must be at least 1",
    "trainer.check_val_every_n_epoch=50": "trainer.check_val_every_n_epoch=50 must be at most trainer.max_epochs",
    "trainer.limit_train_batches=0": "trainer.limit_train_batches=0: at least one batch",
    "scenario.min_difference=1e9 scenario=collision": "scenario.min_difference=1e+09 m must be at most",
    "size.name=../../../evil": "size.name=../../../evil: a name has",
    "scenario.name=balls scenario=collision": "scenario.name=balls is the name of another scenario",
    "render.modalities=[rgb,rgb]": "names a modality twice",
    "scenario.camera.eye=[0,0]": "camera: eye and target must be two points, x, y and z each, and not one above the other",
    "scenario.camera.field_of_view_deg=0": "camera.field_of_view_deg=0",
    "data_dir=": "data_dir= is empty",
    "model=copy_b model.pose=true": "Key 'pose' not in",
    "positions=derendered model.object_type=true": "positions=derendered does not go with model.object_type=true: no de-renderer estimates it",
    "positions=train_ground_truth_test_derendered model.pose=true": "does not go with model.pose=true: no de-renderer estimates it",
    "data_dir=/x=y": "data_dir=/x=y is not key=value; a value with = , : ~ or blanks needs two pairs of quotes",
    "collision": "collision is no override: scenario=collision?",
    "all": "all is no override: render=all or split=all?",
    "colision": "colision is not key=value",
    "lr=0.1": "lr: Key 'lr' not in 'TrainConfig' (did you mean training.learning_rate?)",
    "size=640": "size=640 does not exist; there are 12k, paper, sample, small, tiny (your own folder: --config-dir)",
    "scenario=blocktower split=3to5": "(did you mean 3to4?); there are 3to3, 3to3_seen, 3to3_unseen, 3to4, 4to3, 4to4, 4to4_unseen (",
    "split=al scenario=collision": "(did you mean all?); there are all, cylinder_to_sphere, sphere_to_cylinder (",
    "seed=0,1": "seed=0,1: several values are a sweep, a run each: add -m",
    "logger=csv,tensorboard": "a list needs brackets: 'logger=[csv,tensorboard]'",
    "compare=[a@size=640,in]": "no name in this list has =; changes are written as in the names of folders",
    "models=[a=b]": "a name with = : or blanks needs quotes of its own: \"models=['a=b',c]\"",
    "scenario=balls split=all": "split=all does not go with balls: use 4to4, 4to2, 4to3, 4to5, 4to6",
    "hydra.job.chdir=true": "hydra.job.chdir=true: data_dir= and other relative paths would be of each run's folder",
    "hydra.job.name=x/y": "hydra.job_logging or hydra.job.name: Unable to configure handler 'file' ([Errno 2]",
    "hydra.job_logging.root.level=FOO": "Unable to configure root logger (Unknown level: 'FOO')",
    "trainer.max_epochs=1 ~trainer": "has no value; --help says what it is",
    "training.learning_rate=1e38": "the latter at most 1e+06",
    "trainer.log_every_n_steps=-1": "trainer.log_every_n_steps=-1 must be at least 1",
    "+trainer.accumulate_grad_batches=-3": "trainer.accumulate_grad_batches=-3 must be at least 1",
    "scenario.clock.state_rate_hz=1000000": "states in a sequence are more than 10,000",
    "scenario.clock.state_rate_hz=35": "scenario.solver.step_rate_hz=960 must be a multiple of scenario.clock.state_rate_hz=35",
    "scenario.gravity_z=1e30": "scenario.gravity_z=1e+30 must be negative",
    "scenario=balls scenario.displacement=[nan,1]": "scenario.displacement.0=nan must be finite",
    "scenario.confounders.mass=[1e30]": "mass must be > 0 and at most 1e+06 kg",
    "scenario.task.metric_dims=0": "scenario.task.metric_dims=0 must be 1, 2 or 3",
    "size.num_experiments.blocktower.3=9223372036854775806": "9223372036854775806 experiments are more than 10,000,000",
    "logger=[] +logger._target_=x": "logger._target_ is no block with a _target_: its YAML starts with the line",
    "threads=99999": "threads=99999 must be from 1 to ",
    "model.gru_layers=10000": "model.gru_layers=10000 must be at most 100",
}


# found only when a run starts, because constructors and Lightning refuse them
IN_A_RUN = re.compile(
    r".*(_target_|ckpt|predictor|logger|width=1|derenderer (loss|training)|hidden_dim=0|gru_layers|npe model|interaction=mlp|max_epoch=3 |trainer.max_epoch=|schedule"
    r"|supervised|precision|hydra\.|.*~trainer|accumulate|friction|positions=.* model)"
)
COMPOSED = [mistake for mistake in MISTAKES if not IN_A_RUN.match(mistake)]
SLOW = re.compile(
    r".*(collections|mine.loss|derenderer (loss|training)|README|nowhere|positions=train|mine|predictor=a.ckpt model|Adan|max_epoch=3)"
)  # as others


@pytest.mark.parametrize("mistake", COMPOSED)
def test_a_mistake_ends_composing_with_one_line(mistake: str) -> None:
    with pytest.raises(Exception) as caught:  # noqa: PT011 (of several kinds, and `is_user_error` judges them)
        settings("train", *mistake.split())
    assert is_user_error(caught.value)
    message = explain(caught.value)
    assert MISTAKES[mistake] in message
    assert "\n" not in message
    assert len(message) < 600


def test_a_number_for_a_name_needs_quotes(tmp_path: Path) -> None:
    path = tmp_path / "size" / "640.yaml"
    path.parent.mkdir()
    path.write_text("name: x\n")
    with pytest.raises(ValueError, match="override must be a string") as caught:
        settings("train", f"hydra.searchpath=[file://{tmp_path}]", "size=640")
    assert is_user_error(caught.value)
    assert (
        explain(caught.value) == "size=640: a name that looks like a number needs two pairs of quotes: \"size='640'\""
    )


def test_a_number_in_quotes_is_a_name(tmp_path: Path) -> None:
    (tmp_path / "size").mkdir()
    size = "name: '640'\nexperiments_per_shard: 40\nnum_experiments: {collision: {'2': 40}}\n"
    (tmp_path / "size" / "640.yaml").write_text(size)
    folders = (f"data_dir={tmp_path}", f"source.outputs={tmp_path}")
    run("train", "--config-dir", tmp_path, "scenario=collision", "model=copy_c", "size='640'", *folders)
    assert (tmp_path / "collision/all/copy_c/full/ground_truth/seed0+size-640/metrics.json").is_file()


def test_a_wrong_value_of_a_right_key_gets_no_suggestion() -> None:
    with pytest.raises(Exception) as caught:  # noqa: PT011 (of Hydra)
        settings("train", "scenario=collision", "seed=abc")
    assert explain(caught.value) == "seed: Value 'abc' of type 'str' could not be converted to Integer"


@pytest.mark.parametrize(
    ("override", "package"),
    [
        *(("optimizer=mine", "training.optimizer"), ("schedule=mine", "training.schedule")),
        *(("callbacks=[mine]", "training.callbacks.mine"), ("logger=[mine]", "logger.<name>")),
        *(("loss=mine", "training.loss"), ("metrics=[mine]", "metrics.<name>")),
    ],
)
def test_a_file_of_the_user_without_its_package_line_is_named(override: str, package: str, tmp_path: Path) -> None:
    path = tmp_path / override.partition("=")[0] / "mine.yaml"
    path.parent.mkdir()
    path.write_text("_target_: nowhere.Mine\n")
    with pytest.raises(Exception) as caught:  # noqa: PT011 (of several kinds)
        settings("train", f"hydra.searchpath=[file://{tmp_path}]", override)
    assert is_user_error(caught.value)
    assert f"with the line '# @package {package}'" in explain(caught.value)


@pytest.mark.parametrize("addresses", ["notanip", "300.0.0.1/99", "10.0.0.1/8"])
def test_proxies_that_are_no_addresses_are_refused(addresses: str) -> None:
    for known in ("*", "", "127.0.0.1,10.0.0.0/8", "::1"):
        settings("study", f"trusted_proxies='{known}'")
    with pytest.raises(CophyError, match=f"trusted_proxies={addresses}: "):
        settings("study", f"trusted_proxies='{addresses}'")


def test_a_module_of_a_command_is_no_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "cophy.commands.train", raising=False)  # another test may have imported it
    with pytest.raises(SystemExit, match=r"train\.py is no program: run src/train\.py, or cophy-train"):
        runpy.run_module("cophy.commands.train", run_name="__main__")


@pytest.mark.parametrize(
    "mistake",
    [
        pytest.param(mistake, marks=[pytest.mark.slow] if SLOW.match(mistake) else [])
        for mistake in MISTAKES
        if mistake not in COMPOSED
    ],
)
def test_a_mistake_ends_a_run_with_one_line(mistake: str, tmp_path: Path, tiny_data: Path) -> None:
    words = ("size=tiny", f"data_dir={tiny_data}", f"hydra.run.dir={tmp_path}", *mistake.split())
    printed = run("train", *words, code=1)
    assert MISTAKES[mistake] in printed
    assert "Traceback" not in printed
    assert len(printed.strip().splitlines()[-1]) < 500


def test_an_ablation_without_its_first_line_names_the_line(tmp_path: Path) -> None:
    (tmp_path / "ablation").mkdir()
    (tmp_path / "ablation" / "narrow.yaml").write_text("model: {hidden_dim: 8}\n")
    printed = run("train", "--config-dir", tmp_path, "ablation=narrow", f"hydra.run.dir={tmp_path}", code=1)
    assert "ablation=narrow: its YAML must start with the line '# @package _global_'" in printed


def test_a_misspelt_ablation_stops_before_the_first_job(tmp_path: Path) -> None:
    """A typo inside an ablation must not run as the full model."""
    ablations = tmp_path / "ablation"
    ablations.mkdir()
    (ablations / "typo.yaml").write_text("# @package _global_\nmodel: {gatting: static}\n")
    where = (f"hydra.searchpath=[file://{tmp_path}]", f"hydra.sweep.dir={tmp_path}/out")
    assert "gatting" in run("train", "-m", *where, "ablation=full,typo", code=1)
    assert not list(tmp_path.rglob("metrics.json"))


@pytest.mark.parametrize(("command", "key"), [("generate", "seed"), ("audit", "data_seed")])
def test_the_seed_of_a_dataset_may_be_called_seed(command: str, key: str) -> None:
    assert settings(command, f"{key}=3").data_seed == 3


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        (("model=alongside_posed",), (64, 40, 32)),
        (("model=alongside_canonical", "size=paper"), (256, 20, 32)),
        (("model=alongside_posed", "size=paper"), (256, 20, 64)),
        (("model=alongside_posed", "size=paper", "training.batch_size=8", "trainer.max_epochs=3"), (8, 3, 64)),
        (("model=alongside", "size=paper"), (64, 40, 32)),
    ],
)
def test_a_model_may_have_its_own_width_and_schedule_at_a_size(
    keys: tuple[str, ...], expected: tuple[int, ...]
) -> None:
    config = composed("train", *keys)
    assert (config.training.batch_size, config.trainer.max_epochs, config.model.hidden_dim) == expected


def test_the_seed_of_a_training_is_not_that_of_its_dataset() -> None:
    config = settings("train", "seed=3")
    assert (config.seed, config.data_seed) == (3, 0)


def test_every_command_keeps_its_files_in_the_folders_of_the_environment() -> None:
    outputs = ("${folder:COPHY_OUTPUTS}", "${source.outputs}", "${outputs}/")
    begins = {"data_dir": "${folder:COPHY_DATA}", "outputs": outputs, "directory": outputs}
    folders = [
        (path.name, key, value)
        for path in (ROOT / "conf").glob("*.yaml")
        for key, value in re.findall(r"^(data_dir|outputs|directory): (\S+)", path.read_text(), re.MULTILINE)
    ]
    assert len(folders) > 10
    assert [(name, key) for name, key, value in folders if not value.startswith(begins[key])] == []


@pytest.mark.parametrize("command", ["train", "report", "predict"])
def test_environment_variables_name_the_folders(command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    needed = ["observed=a", "initial=b", "derenderer=c", "predictor=d"] if command == "predict" else []
    monkeypatch.setenv("HOME", str(tmp_path))
    for outputs, folder in (("~/runs", f"{tmp_path}/runs"), ("relative", "relative"), ("", "outputs")):
        monkeypatch.setenv("COPHY_DATA", outputs and f"{outputs}/data")
        monkeypatch.setenv("COPHY_OUTPUTS", outputs)
        config = settings(command, *needed)
        assert getattr(config, "data_dir", None) in (None, f"{folder}/data" if outputs else "data")
        written = config.source.outputs if command == "train" else getattr(config, "outputs", None) or config.directory
        assert Path(written).is_relative_to(folder)
    config = settings(command, *needed, *(["data_dir='~/x'"] if hasattr(config, "data_dir") else []))
    assert getattr(config, "data_dir", None) in (None, f"{tmp_path}/x")
