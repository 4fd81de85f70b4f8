"""From a split, or numbers of objects, to sets of experiments."""

from pathlib import Path

import pytest

from cophy.dataset.source import Source, generated_sets
from cophy.errors import CophyError
from tests.conftest import settings


def chosen(*overrides: str) -> dict:
    """Scenario, split, size and numbers of objects, as the command line has them."""
    found = settings("generate", "scenario=balls", "size=tiny", *overrides)
    return {"scenario": found.scenario, "split": found.split, "num_objects": found.num_objects, "size": found.size}


@pytest.mark.parametrize(
    ("overrides", "counts"), [(["split=4to6"], [4, 6]), (["split=4to4"], [4]), (["num_objects=[5,2]"], [2, 5])]
)
def test_a_split_names_the_datasets_it_trains_and_tests_on(overrides: list[str], counts: list[int]) -> None:
    of_generator = generated_sets(**chosen(*overrides), data_seed=0, data_dir=Path("data"))
    of_source = Source("generated", "outputs").experiment_sets(**chosen(*overrides), data_seed=0, data_dir=Path("data"))
    assert [each.spec.num_objects for each in of_generator] == counts
    assert [each.id for each in of_source] == [each.id for each in of_generator]


def test_a_split_of_another_scenario_is_refused() -> None:
    found = chosen()
    found["split"].name = "sphere_to_cylinder"
    with pytest.raises(CophyError, match="split=sphere_to_cylinder does not go with balls"):
        generated_sets(**found, data_seed=0, data_dir=Path("data"))


def test_only_the_same_data_seed_leaves_test_experiments_unseen() -> None:
    (states,) = generated_sets(**chosen(), data_seed=3, data_dir=Path("data"))
    assert states.has_same_splits(data_seed=3, trained_on=[])
    assert not states.has_same_splits(data_seed=4, trained_on=[states.id])


def test_the_command_of_another_script_is_about_the_same_dataset() -> None:
    (states,) = generated_sets(**chosen(), data_seed=3, data_dir=Path("data"))
    assert states.command == (
        "python src/generate.py scenario=balls size=tiny 'num_objects=[4]' data_seed=3 data_dir=data"
    )
    assert states.command_for("derender") == states.command.replace("generate", "derender")
