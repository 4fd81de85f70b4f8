"""The place of a run among the others."""

from pathlib import Path

from cophy.training.runs.identity import Run


def run_in(directory: Path) -> Run:
    return Run("balls", "4to4", "cophynet", "full", "ground_truth", 1, "tiny", directory)


def test_a_run_in_its_place_knows_the_root_of_all() -> None:
    place = Path("balls/4to4/cophynet/full/ground_truth/seed1")
    assert run_in(Path("outputs") / place).root == Path("outputs")
    assert run_in(Path("elsewhere")).root is None


def test_names_are_all_but_the_directory() -> None:
    assert list(run_in(Path("x")).names()) == ["scenario", "split", "model", "ablation", "positions", "seed", "size"]
