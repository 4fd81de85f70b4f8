"""From a split, or numbers of objects, to sets of experiments."""

import pytest

from cophy.config import experiments_of, generated_by
from tests.conftest import settings

BALLS = ("scenario=balls", "size=tiny", "data_dir=data")


@pytest.mark.parametrize(
    ("overrides", "counts"), [(["split=4to6"], [4, 6]), (["split=4to4"], [4]), (["num_objects=[5,2]"], [2, 5])]
)
def test_a_split_names_the_datasets_it_trains_and_tests_on(overrides: list[str], counts: list[int]) -> None:
    config = settings("train", *BALLS, *overrides)
    assert [each.spec.num_objects for each in generated_by(config)] == counts
    assert [each.id for each in experiments_of(config, config.num_objects)] == [
        each.id for each in generated_by(config)
    ]


def test_only_the_same_data_seed_leaves_test_experiments_unseen() -> None:
    (states,) = generated_by(settings("generate", *BALLS, "data_seed=3"))
    assert states.has_same_splits(data_seed=3, trained_on=[])
    assert not states.has_same_splits(data_seed=4, trained_on=[states.id])


def test_the_command_of_another_script_is_about_the_same_dataset() -> None:
    (states,) = generated_by(settings("generate", *BALLS, "data_seed=3"))
    assert states.command == (
        "python src/generate.py scenario=balls size=tiny 'num_objects=[4]' data_seed=3 data_dir=data"
    )
    assert states.command_for("derender") == states.command.replace("generate", "derender")
