"""The place of a run among the others."""

from pathlib import Path

from omegaconf import OmegaConf

from cophy.training.run import Run, differences, plain_value


def run_in(directory: Path) -> Run:
    return Run("balls", "4to4", "cophynet", "full", "ground_truth", 1, "tiny", "+size-tiny", directory)


def test_a_run_in_its_place_knows_the_root_of_all() -> None:
    place = Path("balls/4to4/cophynet/full/ground_truth/seed1+size-tiny")
    assert run_in(Path("outputs") / place).root == Path("outputs")
    assert run_in(Path("elsewhere")).root is None


def test_names_are_all_but_the_directory() -> None:
    names = ["scenario", "split", "model", "ablation", "positions", "seed", "size", "variant"]
    assert list(run_in(Path("x")).names()) == names


def test_what_changes_a_result_is_a_difference() -> None:
    own = {"trainer": {"max_epochs": 2, "devices": 2}, "size": {"num_experiments": 40}}
    expected = {"trainer": {"max_epochs": 40, "devices": 1}, "size": {"num_experiments": 40}}
    assert list(differences("cfg", own, expected)) == [("cfg.trainer.devices", 2), ("cfg.trainer.max_epochs", 2)]
    assert list(differences("trainer", own["trainer"], expected["trainer"])) == [("trainer.max_epochs", 2)]
    assert list(differences("model", {"dim": 8, "new": 1}, {"dim": 8})) == [("model.new", 1)]


def test_a_key_comes_plain_with_its_references_resolved() -> None:
    config = OmegaConf.create({"a": {"b": "${c}"}, "c": 3})
    assert plain_value(config, "a") == {"b": 3}
    assert plain_value(config, "c") == 3
    assert plain_value(config, "missing") is None
