"""Run a command; what the user can mend ends it with one line: what is wrong, where, and the nearest right spelling.

What `--help` says of the keys of a command: their values, and the meaning that the YAML's comments give them.

The templates in conf/*.yaml (hydra.help.template) call it as `${keys_of:<file>,...}`.
"""

import errno
import json
import os
import re
import shutil
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from difflib import get_close_matches
from enum import Enum
from functools import wraps
from pathlib import Path
from textwrap import wrap
from typing import Any
from uuid import uuid4

import yaml
from hydra._internal import defaults_list
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.object_type import ObjectType
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, MissingConfigException
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from cophy.config import CONF
from cophy.errors import SAFE, CophyError
from cophy.training.run import FAILURE, SWEEP

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


# every command imports this module with `cophy.cli`
OmegaConf.register_new_resolver("keys_of", keys_of, replace=True)


OF_YOUR_OWN = " (a folder of your own: --config-dir)"  # what else a group can be given
# how Hydra names a file of conf/ablation or conf/row that it cannot compose
IN_A_FILE = re.compile(r"In '(ablation|row)/([\w/]+)': \w+ raised while composing config:\s*(.*?)\s*(full_key|$)")
# and a choice of confounders= where the scenario's defaults name none
WITHOUT_GRIDS = re.compile(
    r"Could not override 'confounders'\. No match in the defaults list\..*\+(confounders=\S+)", re.DOTALL
)

# how submitit and Hydra say that jobs cannot be started, or that one left no result
OF_SLURM = {
    'Could not detect "srun"': "hydra/launcher=slurm: there is no srun here, so this is no node of a SLURM cluster",
    "has not produced any output": "a job ended without a result; what it said is in .submitit/ among the runs; the same command goes on",
    "Could not load 'hydra/launcher/submitit_slurm'": "hydra/launcher=slurm needs a package: pip install -e '.[cluster]'",
}

# hydra/launcher=local: joblib replaces a worker whose memory has grown; no run is lost
warnings.filterwarnings("ignore", "A worker stopped while some jobs were given to the executor")

_sweeps: list[tuple[Path, str]] = []  # of this process: the root of the runs, and a name that only this sweep has


class NoteSweep(Callback):
    """Hydra calls it in the process that starts the runs (conf/train.yaml)."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Remember where the runs of this sweep go, and name it to them, in whatever processes they are."""
        os.environ[SWEEP] = uuid4().hex
        _sweeps.append((Path(config.hydra.sweep.dir), os.environ[SWEEP]))


def in_one_line(task: Callable[[DictConfig], Any]) -> Callable[[DictConfig], Any]:
    """A Hydra task whose mendable errors end the command at once; Hydra would say what it was told before each.

    A sweep goes on with its other runs, and `run` names those that failed.
    """

    @wraps(task)
    def ends(cfg: DictConfig) -> Any:
        try:
            return task(cfg)
        except Exception as error:
            if HydraConfig.get().mode is RunMode.MULTIRUN or not is_mendable(error):
                raise
            sys.exit(f"{sys.argv[0]}: {explain(error)}")

    return ends


def run(main: Callable[[], Any]) -> None:
    """Run a Hydra main. An error that the user can mend becomes one line, any other keeps its traceback."""
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # let errors come here whole instead of being printed by Hydra
    _sweeps.clear()
    try:
        main()
    except Exception as error:
        if not is_mendable(error):
            raise
        failed = _failures()
        sys.exit(f"{sys.argv[0]}: {_list(failed) if len(failed) > 1 else explain(error)}")
    except KeyboardInterrupt:
        sys.exit(f"{sys.argv[0]}: interrupted; finished shards and checkpoints are kept")


def _failures() -> list[str]:
    """A line for each run of this process's last sweep that failed: its directory, and why."""
    if not _sweeps:
        return []
    root, sweep = _sweeps[-1]
    notes = {path.parent: json.loads(path.read_bytes()) for path in sorted(root.rglob(FAILURE))}
    return [f"{directory}: {note['error']}" for directory, note in notes.items() if note.get("sweep") == sweep]


def _list(failed: list[str]) -> str:
    return "\n    ".join([f"{len(failed)} runs failed; the same command makes them again", *failed])


def is_mendable(error: Exception) -> bool:
    """Whether the person at the terminal can mend it, so that one line is enough."""
    of_a_file = isinstance(error, OSError) and (error.filename is not None or error.errno == errno.ENOSPC)
    of_settings = isinstance(error, HydraException | OmegaConfBaseException | CophyError) or _is_of_choices(error)
    return of_a_file or of_settings or _of_slurm(error) != ""


def explain(error: BaseException) -> str:
    """One line for an error that is mendable."""
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:  # Hydra's own files name none
        return f"no space left for {error.filename or 'what a run begins with'}: {SAFE}"
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if slurm := _of_slurm(error):
        return slurm
    if _is_of_choices(error):
        return f"a group ({', '.join(_no_names())}) takes the name of a file in conf/, or names in brackets: {error}"
    if file := IN_A_FILE.match(str(error)):
        return _explain_file(*file.group(1, 2, 3))
    if choice := WITHOUT_GRIDS.match(str(error)):
        return f"{choice[1]} does not go with this scenario, which has one grid; it goes with balls and collision"
    if isinstance(error, MissingConfigException) and error.options is not None and error.missing_cfg_file:
        return _explain_choice(error.missing_cfg_file, error.options)
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    if isinstance(cause, MissingMandatoryValue):
        needed = OmegaConf.missing_keys(cause.parent_node) if cause.parent_node is not None else {str(cause.full_key)}
        return f"{'=, '.join(sorted(needed))}= has to be given; --help says what it is"
    if isinstance(cause, OmegaConfBaseException) and cause.key is not None:
        what = (cause.msg or str(cause)).splitlines()[0]
        return f"{cause.full_key or cause.key}: {what}{_suggest_key(str(cause.key), cause.parent_node)}"
    return " ".join(line.strip() for line in str(error).splitlines() if line.strip())


def _is_of_choices(error: BaseException) -> bool:
    """Whether Hydra fails over what a group is given: scenario=null, split=[3]."""
    frames = traceback.extract_tb(error.__traceback__)
    return bool(frames) and frames[-1].filename == defaults_list.__file__ and not isinstance(error, HydraException)


def _no_names() -> list[str]:
    """What groups are given on the command line that is no name, and no list of names."""
    words = [word for word in sys.argv[1:] if "=" in word and not word.startswith("-")]  # options have values, too
    given = [each for each in OverridesParser.create().parse_overrides(words) if (CONF / each.key_or_group).is_dir()]
    values = {str(each.input_line): each.value() for each in given}
    return [line for line, value in values.items() if not all(isinstance(name, str) for name in _as_list(value))]


def _as_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _of_slurm(error: BaseException) -> str:
    said = next((said for met, said in OF_SLURM.items() if met in str(error)), "")
    state = re.search(r"\(state: \w+\)", str(error))
    return f"{said} {state[0]}" if said and state else said


def _explain_file(group: str, name: str, what: str) -> str:
    if f"Key '{group}' not in" in what:
        return f"{group}={name}: its YAML must start with the line '# @package _global_'"
    every = "; ablation=full goes with every model" if group == "ablation" else ""
    return f"{group}={name} does not go with this model: {what} (conf/{group}/{name}.yaml sets it{every})"


def _explain_choice(file: str, options: Sequence[str]) -> str:
    group, _, name = file.rpartition("/")
    choices = ", ".join(sorted(options))
    found = f"{group}={name} does not exist{_suggest(name, options)}; there are {choices}"
    return f"{found}{OF_YOUR_OWN}"


def _suggest_key(name: str, node: Any) -> str:
    """The nearest key beside it, or else further down: `max_epochs` is one of `trainer`."""
    if not OmegaConf.is_dict(node):
        return ""
    if (CONF / name).is_dir():
        return f" ({name}= chooses a file of conf/{name}; --help lists the keys)"
    if beside := _suggest(name, [str(key) for key in node]):
        return beside
    inner = {str(group): node._get_node(group) for group in node}
    below = [
        f"{group}.{key!s}" for group, keys in inner.items() if isinstance(keys, DictConfig) and keys for key in keys
    ]
    nearest = get_close_matches(name, [key.rpartition(".")[2] for key in below], n=1)
    found = [key for key in below if key.rpartition(".")[2] in nearest]
    return f" (did you mean {' or '.join(found)}?)" if found else ""


def _suggest(name: str, known: Sequence[str]) -> str:
    close = [match for match in get_close_matches(name, known, n=1) if match != name]
    return f" (did you mean {close[0]}?)" if close else ""
