"""The names of a run, its place among the others, and what makes two configurations the same run."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

METRICS, PREDICTIONS, FAILURE = "metrics.json", "predictions.npz", "failure.json"  # in the directory of a run
SWEEP = "COPHY_SWEEP"  # variable of the environment: a name for the sweep that a run is of
# keys that change no result: where and how fast it is made, what is shown, and which names a scenario lists
NO_RESULT = {
    *("trainer.accelerator", "trainer.devices", "trainer.num_nodes", "trainer.strategy", "trainer.profiler"),
    *("trainer.enable_progress_bar", "trainer.enable_model_summary", "trainer.log_every_n_steps"),
    *("scenario.task.splits", "render.backend"),
}


@dataclass(frozen=True)
class Run:
    """What train.py does once.

    Attributes:
        scenario, split, model, ablation, positions, seed, size: The names under which it was chosen.
        variant: What it changes beyond its names, for example "+hidden_dim-8"; "" where it changes nothing.
        directory: Where its results go.
    """

    scenario: str
    split: str
    model: str
    ablation: str
    positions: str
    seed: int
    size: str
    variant: str
    directory: Path

    def names(self) -> dict[str, Any]:
        """The names alone."""
        return {key: value for key, value in asdict(self).items() if key != "directory"}

    @property
    def place(self) -> Path:
        """The directory's path below the root of all runs (conf/train.yaml, hydra.run.dir)."""
        last = f"seed{self.seed}{self.variant}"
        return Path(self.scenario, self.split, self.model, self.ablation, self.positions, last)

    @property
    def short_name(self) -> str:
        """What tells it from all runs beside it, in one word: its place without what is as usual."""
        usual = {("ablation", "full"), ("positions", "ground_truth")}
        chosen = [(key, getattr(self, key)) for key in ("scenario", "split", "model", "ablation", "positions")]
        return "_".join([*(value for key, value in chosen if (key, value) not in usual), self.place.name])

    @property
    def root(self) -> Path | None:
        """The root of all runs, where the run lies in its place below it."""
        depth = len(self.place.parts)
        return self.directory.parents[depth - 1] if self.directory.parts[-depth:] == self.place.parts else None

    @property
    def checkpoints(self) -> Path:
        """The folder of its checkpoints."""
        return self.directory / "checkpoints"


def differences(key: str, own: Any, expected: Any) -> Iterator[tuple[str, Any]]:
    """The keys that can change a result and whose values are not what is expected, with their own values.

    Args:
        key: Of both, in the whole configuration.
        own: A value, or a dict of them.
        expected: The same of another configuration.
    """
    if isinstance(own, dict) and isinstance(expected, dict):
        for name in sorted(own.keys() | expected.keys()):
            yield from differences(f"{key}.{name}", own.get(name), expected.get(name))
    elif own != expected and key not in NO_RESULT:
        yield key, own


def plain_value(config: DictConfig | ListConfig, key: str) -> Any:
    """What a key of a configuration holds, as dicts, lists and values, enumerations by name."""
    node = OmegaConf.select(config, key)
    return OmegaConf.to_container(node, resolve=True, enum_to_str=True) if OmegaConf.is_config(node) else node
