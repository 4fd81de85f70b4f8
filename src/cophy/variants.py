"""What a run changes beyond its names, as the end of its directory's name: `seed0+size-12k+hidden_dim-8`.

Two runs that differ in anything that can change a result get different directories, whoever starts them and in whatever
order their keys are given. conf/train.yaml asks for it as `${variant:}`. A path with `=` and `,` would need quotes twice
where it is the value of a key (`ckpt=`, `derenderer=`), so the name has neither.
"""

import functools
import hashlib
import json
import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

from omegaconf import DictConfig, OmegaConf

from cophy.config import composed
from cophy.training.run import differences, plain_value

NAMES = ("scenario", "split", "model", "ablation", "source")  # groups whose choices are parts of the path
CHOICES = ("size", "confounders", "trainer", "optimizer", "schedule")  # groups whose choice says more than its keys
COMPARED = ("size", "data_seed", "scenario", "split", "model", "training", "trainer", "derenderer")
OF_DERENDERERS = ("render", "num_images", "num_objects")
LONGEST = 100  # characters; file systems allow 255


def variant(config: DictConfig, choices: Mapping[str, Any]) -> str:
    """What a run changes beyond its names, "" where it changes nothing.

    Args:
        config: The run's whole configuration.
        choices: `hydra.runtime.choices`: which choice of every group it took.

    Returns:
        For example "+confounders-released+hidden_dim-8"; where that is long, its beginning and a hash of all.
    """
    named = [f"{group}={choices[group]}" for group in NAMES]
    usual = of_choices(*named).hydra.runtime.choices
    groups = [group for group in CHOICES if choices.get(group) != usual.get(group)]
    expected = of_choices(*named, *(f"{group}={choices[group]}" for group in groups))
    keys = (*COMPARED, *OF_DERENDERERS) if str(choices["model"]).startswith("derenderer") else COMPARED
    found = dict(
        pair for key in keys for pair in differences(key, plain_value(config, key), plain_value(expected, key))
    )
    found = {key: value for key, value in found.items() if not _refers(config, key) or not _refers(expected, key)}
    last = Counter(key.rpartition(".")[2] for key in found)
    changed = [(key if last[short := key.rpartition(".")[2]] > 1 else short, found[key]) for key in sorted(found)]
    own = [(group, choices[group]) for group in groups]
    text = "+".join(f"{key}-{_readable(value)}" for key, value in [*own, *changed])
    if len(text) > LONGEST:
        text = f"{text[: LONGEST - 9]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    return f"+{text}" if text else ""


@functools.cache
def of_choices(*choices: str) -> DictConfig:
    """What these choices of groups compose: kept, as every run asks more than once. Do not change it."""
    return composed("train", *choices, return_hydra_config=True)


def _refers(config: DictConfig, key: str) -> bool:
    """Whether it only repeats another key, as training.optimizer.lr does."""
    parent, _, name = key.rpartition(".")
    node = OmegaConf.select(config, parent) if parent else config
    return isinstance(node, DictConfig) and name in node and OmegaConf.is_interpolation(node, name)


def _readable(value: Any) -> str:
    """A value as part of the name of a directory; of one that has keys of its own, a hash."""
    if isinstance(value, dict):
        return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:6]
    return re.sub(r"[^\w.-]+", "_", str(value)).strip("_")


def _of_whole(*, _root_: DictConfig) -> str:
    return variant(_root_, _root_.hydra.runtime.choices)


# here and not in `register`: a process that Hydra's launchers start imports this module with the command, and no more
OmegaConf.register_new_resolver("variant", _of_whole, replace=True)
