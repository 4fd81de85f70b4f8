"""What a dataset says is the command that makes it, makes this very dataset."""

import shlex
from pathlib import Path

import pytest

from cophy.commands.generate import asked_for
from cophy.config import generated_by, settings
from cophy.dataset.images import Images
from cophy.dataset.states import States
from cophy.oracles.forecasts import OracleForecasts, OracleSettings
from cophy.scenario.rendering import Backend, RenderSettings

OVERRIDES = {
    "as usual": (),
    "another grid": ("confounders=released",),
    "more experiments": ("size.num_experiments.balls.4=80", "+size.num_experiments.balls.7=4"),
    "another scenario": ("scenario.solver.iterations=80", "scenario.displacement=[0.5,1]"),
}


def sets_of(*words: str) -> list[States]:
    return generated_by(settings("generate", *words))


def words_of(command: str, script: str = "generate") -> list[str]:
    first, *words = shlex.split(command.removeprefix("python "))
    assert first == f"src/{script}.py"
    return words


@pytest.mark.parametrize("overrides", OVERRIDES.values(), ids=OVERRIDES)
def test_the_command_makes_this_dataset(overrides: tuple[str, ...], tmp_path: Path) -> None:
    (states,) = sets_of("scenario=balls", "size=tiny", "data_seed=3", f"data_dir={tmp_path}", *overrides)
    (made,) = sets_of(*words_of(states.command))
    assert (made.directory, made.command) == (states.directory, states.command)
    assert ("++" in states.command) == bool(overrides)


def test_the_command_of_oracles_asks_them_the_same(tmp_path: Path) -> None:
    (states,) = sets_of(
        "scenario=blocktower", "size=tiny", "split=4to4", f"data_dir={tmp_path}", "scenario.task.stable_speed=0.2"
    )
    forecasts = OracleForecasts(states, OracleSettings(draws=7, max_configurations=5, noise=0.1, max_experiments=6))
    said = settings("generate", *words_of(forecasts.command))
    (made,) = generated_by(said)
    assert [each.directory for each in asked_for(made, said)] == [states.directory, forecasts.directory]


def test_the_command_of_pictures_draws_them(tmp_path: Path) -> None:
    (states,) = sets_of("scenario=balls", "size=tiny", "confounders=released", f"data_dir={tmp_path}")
    pictures = Images(states, RenderSettings(["rgb"], 32, Backend.tiny))
    said = settings("generate", *words_of(pictures.command))
    (made,) = generated_by(said)
    assert [each.directory for each in asked_for(made, said)] == [states.directory, pictures.directory]
