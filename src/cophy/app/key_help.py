"""What `--help` says of the keys of a command: their values, and the meaning that the YAML's comments give them.

The templates in conf/*.yaml (hydra.help.template) call it as `${keys_of:<file>,...}`.
"""

import json
import re
import shutil
from collections.abc import Iterator
from enum import Enum
from textwrap import wrap
from typing import Any

import yaml
from hydra.core.global_hydra import GlobalHydra
from hydra.core.object_type import ObjectType
from omegaconf import DictConfig, OmegaConf

from cophy.app.composition import CONF

WIDEST, INDENT = 100, 32
# a comment is "<meaning>; ours: <why this value>", or "<meaning>; paper Sec. 3"; a key without a meaning is not shown
WHY = re.compile(r"(^|[;.] )(ours|paper)\b.*")
SELDOM = "# seldom changed"  # a line that begins so hides the keys below it, up to an empty line
IN_DEFAULTS_ALONE = ("schema/", "override ", "optional ")


def meanings(file: str) -> dict[str, str]:
    """Keys of conf/<file>.yaml whose comment says what they are, and that meaning; keys in a block are "block.key"."""
    text = (CONF / f"{file}.yaml").read_text()
    shown = re.sub(rf"^ *{SELDOM}.*?(\n\n|\Z)", "\n", text, flags=re.MULTILINE | re.DOTALL)
    block = yaml.compose(shown)
    assert isinstance(block, yaml.MappingNode)
    return {key: said for key, said in _comments(block, shown.splitlines(), "") if said}


def _comments(block: yaml.MappingNode, lines: list[str], prefix: str) -> Iterator[tuple[str, str]]:
    for key, value in block.value:
        if isinstance(value, yaml.MappingNode) and not value.flow_style and key.value != "hydra":
            yield from _comments(value, lines, f"{prefix}{key.value}.")
        elif isinstance(value, yaml.ScalarNode) or value.flow_style:
            rest = lines[value.end_mark.line][value.end_mark.column :].strip()
            yield f"{prefix}{key.value}", WHY.sub("", rest.removeprefix("#").strip())


def groups(file: str) -> list[str]:
    """Groups of choices that the defaults list of conf/<file>.yaml names."""
    entries = yaml.safe_load((CONF / f"{file}.yaml").read_text())["defaults"]
    names = [name for entry in entries if isinstance(entry, dict) for name in entry]
    return [name for name in names if not name.startswith(IN_DEFAULTS_ALONE)]


def keys_of(file: str, *more: str, _root_: DictConfig) -> str:
    """The part of a help text that lists groups with their choices, and keys with their meaning.

    Args:
        file: Of conf/, whose groups and keys are listed.
        more: Further groups, and further keys as "<group>.<key>", of the file that the group has chosen. A group or
            of the file itself is left out with "-" before it.
    """
    added = [name for name in more if not name.startswith("-")]
    chosen = _root_.hydra.runtime.choices
    choices = []
    for group in [*groups(file), *(name for name in added if "." not in name)]:
        options = GlobalHydra.instance().config_loader().get_group_options(group.lstrip("+"), ObjectType.CONFIG)
        if len(options) > 1 and f"-{group}" not in more:
            choices += _entry(f"{group}={_plain(chosen.get(group, ''))}", ", ".join(options))
    said = meanings(file)
    for name in (name for name in added if "." in name):
        group, _, key = name.partition(".")
        said[name] = meanings(f"{group}/{chosen[group]}")[key]
    lines = ["Choices:", *choices, "", "Keys:"] if choices else ["Keys:"]
    for key, meaning in said.items():
        lines += _entry(f"{key}={_value(_root_, key)}", meaning)
    lines += [
        "",
        "All keys: --cfg job. Hydra's own options: --hydra-help.",
    ]
    return "\n".join(lines).replace("$", "$$")  # the whole is a string.Template


def _value(config: DictConfig, key: str) -> str:
    parent, _, name = key.rpartition(".")
    block = OmegaConf.select(config, parent) if parent else config
    return "???" if OmegaConf.is_missing(block, name) else _plain(block[name])


def _plain(value: Any) -> str:
    """As one writes it on the command line."""
    if OmegaConf.is_config(value):
        value = OmegaConf.to_container(value, enum_to_str=True)
    if isinstance(value, Enum):
        return value.name
    return value if isinstance(value, str) else json.dumps(value).replace('"', "").replace(" ", "")


def _entry(name: str, text: str) -> list[str]:
    """A name, and a text beside it that goes on below itself."""
    width = min(shutil.get_terminal_size((WIDEST, 0)).columns, WIDEST)
    lines = wrap(text, width - INDENT) or [""]
    if len(name) > INDENT - 4:
        return [f"  {name}", *(" " * INDENT + line for line in lines)]
    return [f"{f'  {name}':{INDENT}}{lines[0]}".rstrip(), *(" " * INDENT + line for line in lines[1:])]


# every command imports this module with `cophy.app.cli`
OmegaConf.register_new_resolver("keys_of", keys_of, replace=True)
