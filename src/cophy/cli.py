"""Run commands: an error that the user can fix ends in one line with the nearest right spelling, any other keeps its traceback.

The text of `--help` lists the keys of a command with their values and the comments of the YAML; the templates in
conf/*.yaml (hydra.help.template) call it as `${keys_of:<file>,...}`.
"""

import errno
import io
import json
import logging
import os
import re
import select
import shutil
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from difflib import get_close_matches
from enum import Enum
from functools import wraps
from pathlib import Path
from textwrap import wrap
from typing import Any
from uuid import uuid4

import hydra
import yaml
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.object_type import ObjectType
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from cophy.atomic_files import read_json
from cophy.config import CONF, composed, settings
from cophy.errors import SAFE, CophyError, printable
from cophy.schemas import register
from cophy.training.run import FAILURE, SWEEP


class LogFile(logging.FileHandler):
    """The log file of a run, which is opened by the first message."""

    def __init__(self, filename: str) -> None:
        super().__init__(filename, encoding="utf-8", delay=True)
        if not Path(filename).parent.is_dir():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), filename)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 (a method of logging.Handler)
        """Leave a full disk to the files that matter; they are named if they cannot be written."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handleError(record)


def _printable_record(*arguments: Any, **keywords: Any) -> logging.LogRecord:
    """Return a record of a log; the messages of this package may quote files and names from elsewhere."""
    record = _make_record(*arguments, **keywords)
    if str(record.name).partition(".")[0] == __package__:
        record.msg, record.args = printable(record.getMessage()), None
    return record


def print_error_of_thread(arguments: threading.ExceptHookArgs) -> None:
    """Print the error that ended a thread, unless TensorBoard's could not write: the run raises that error, too."""
    if not (isinstance(arguments.exc_value, OSError) and type(arguments.thread).__module__.startswith("tensorboard.")):
        threading.__excepthook__(arguments)


# at import, because processes of Hydra's launchers import this module and call no function of it before they need it
_make_record = logging.getLogRecordFactory()
logging.setLogRecordFactory(_printable_record)
threading.excepthook = print_error_of_thread
if isinstance(sys.stdout, io.TextIOWrapper):
    sys.stdout.reconfigure(errors="replace")  # of characters that the terminal or pipe cannot encode

# hydra/launcher=local: joblib replaces a worker whose memory has grown; no run is lost
warnings.filterwarnings("ignore", "A worker stopped while some jobs were given to the executor")

_outputs: list[tuple[Path, str | None]] = []  # of this process: folder of a run, or root of a sweep and its unique name


class NoteOutputs(Callback):
    """Note where files go, and the name of a sweep; Hydra calls this in the process that starts the runs (conf/train.yaml)."""

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Note the folder of a run."""
        HydraConfig.instance().set_config(config)  # run.dir refers to it
        with suppress(OmegaConfBaseException):  # Hydra itself reports the error
            _outputs.append((Path(config.hydra.run.dir), None))

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Put the name of the sweep into the environment, from where its runs copy it into failure.json."""
        os.environ[SWEEP] = uuid4().hex
        _outputs.append((Path(config.hydra.sweep.dir), os.environ[SWEEP]))


def command(name: str) -> Callable[[Callable[[DictConfig], Any]], Callable[[], None]]:
    """Make a command of a function that takes the configuration conf/<name>.yaml with the overrides of the command line."""
    register()

    def decorate(function: Callable[[DictConfig], Any]) -> Callable[[], None]:
        if function.__module__ == "__main__":  # its first lines would run, and nothing else
            sys.exit(f"{function.__code__.co_filename} is no program: run src/{name}.py, or cophy-{name}")

        @wraps(function)
        def task(cfg: DictConfig) -> Any:
            try:
                if HydraConfig.get().job.chdir:
                    raise CophyError(
                        "hydra.job.chdir=true: data_dir= and other relative paths would be of each run's folder"
                    )
                return function(cfg)
            except Exception as error:  # a sweep continues with its other runs
                if HydraConfig.get().mode is RunMode.MULTIRUN or not is_user_error(error):
                    raise
                sys.exit(
                    printable(f"{sys.argv[0]}: {explain(error)}")
                )  # here, so that Hydra does not log the error, too

        main = hydra.main(version_base="1.3", config_path=str(CONF), config_name=name)(task)

        @wraps(function)
        def run() -> None:
            os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # Hydra raises errors instead of printing them
            _outputs.clear()
            try:
                main()
                sys.stdout.flush()
            except BrokenPipeError:
                if not _is_closed_pipe(sys.stdout.fileno()):
                    raise
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                sys.exit(128 + signal.SIGPIPE)
            except Exception as error:
                if not is_user_error(error):
                    raise
                failures = _failed_runs()
                sys.exit(
                    printable(f"{sys.argv[0]}: {_list_failures(failures) if len(failures) > 1 else explain(error)}")
                )
            except KeyboardInterrupt:
                sys.exit(f"{sys.argv[0]}: interrupted; finished shards and checkpoints are kept")

        return run

    return decorate


def _is_closed_pipe(descriptor: int) -> bool:
    """Return whether the reader of a pipe has ended, as `head` does after some lines."""
    poll = select.poll()
    poll.register(descriptor, 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


def _failed_runs() -> list[str]:
    """Return a line for each failed run of this process's last sweep: its directory, and the error."""
    root, sweep = _outputs[-1] if _outputs else (Path(), None)
    if sweep is None:
        return []
    failures = []
    for path in sorted(root.rglob(FAILURE)):
        with suppress(OSError, ValueError):  # a file that no run of this sweep wrote
            note = read_json(path)
            if note.get("sweep") == sweep:
                failures.append(f"{path.parent}: {note['error']}")
    return failures


def _list_failures(failures: list[str]) -> str:
    return "\n    ".join([f"{len(failures)} runs failed; the same command runs them again", *failures])


# Errors

OWN_FOLDER = " (your own folder: --config-dir)"  # where else the file of a choice can be
# how Hydra names a file that it cannot compose
IN_A_FILE = re.compile(r"In '(\w+)/([\w/]+)': \w+ raised while composing config:\s*(.*?)\s*(full_key|$)")
LOGGING_ERROR = "Unable to configure "  # Python's, before a run begins
PACKAGES = {  # first lines of the files in these groups; those of ablations and rows have _global_
    **dict.fromkeys(("loss", "optimizer", "schedule"), "training.{group}"),
    **{"callbacks": "training.callbacks.{name}", **dict.fromkeys(("logger", "metrics"), "{group}.{name}")},
}
NO_NAME = "Config group override must be a string or a list."  # Hydra's, of a choice that is no text
# Hydra's, of several values without -m, as seed=0,1 and seed=range(3)
NO_SWEEP = re.compile(r"Ambiguous value for argument '(.*)'|Sweep parameters '(.*)' requires --multirun")
LISTS = ("num_objects", "metrics", "callbacks", "logger", "models", "splits", "compare", "render.modalities")  # keys
FULL_DISK = (errno.ENOSPC, errno.EDQUOT)
OF_DISKS = (*FULL_DISK, errno.EIO, errno.EROFS, errno.EFBIG, errno.ESTALE)  # errors of writing may name no file
SECOND_NAME = {"compare": ",another"}  # keys whose lists need two names -> the second in an example
OF_RESOLVER = "CophyError raised while resolving interpolation: "
SLURM_ERRORS = {  # text in errors of Hydra and submitit -> explanation
    'Could not detect "srun"': "hydra/launcher=slurm: there is no srun here, so this is no node of a SLURM cluster",
    "has not produced any output": "a job ended without a result; its output is in .submitit/ next to the runs; the same command continues",
    "Could not load 'hydra/launcher/submitit_slurm'": "hydra/launcher=slurm needs a package: pip install 'cophy[cluster]'",
}


def is_user_error(error: BaseException) -> bool:
    """Return whether the user can fix an error, so that one line is enough."""
    if isinstance(error, OSError) and (error.filename is not None or error.errno in OF_DISKS):
        return True
    if isinstance(error, HydraException | OmegaConfBaseException | CophyError) or str(error).startswith(LOGGING_ERROR):
        return True
    return _is_refused_by_hydra(error) or _explain_slurm(error) != ""


def settings_from_python(command: str, *overrides: str) -> Any:
    """Return what a command composes, as `cophy.config.settings`; errors that the user can fix have one line."""
    try:
        return settings(command, *overrides)
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        if not is_user_error(error):
            raise
        raise CophyError(explain(error).removesuffix(OWN_FOLDER)) from None  # Python has no such option


def _is_refused_by_hydra(error: BaseException) -> bool:
    """Return whether Hydra's own code raises ValueError, as for options that do not go together."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    return isinstance(error, ValueError) and bool(frames) and str(frames[-1].f_globals["__name__"]).startswith("hydra.")


def explain(error: BaseException) -> str:
    """Return one line for an error that the user can fix."""
    if isinstance(error, OSError) and (error.filename is not None or error.errno in OF_DISKS):
        # Hydra names none of the first files of a run
        file = os.fsdecode(error.filename) if error.filename is not None else _outputs[-1][0] if _outputs else "a file"
        return f"{file}: {error.strerror}" + (f"; {SAFE}" if error.errno in FULL_DISK else "")
    if slurm := _explain_slurm(error):
        return slurm
    if str(error).startswith(LOGGING_ERROR):
        return f"hydra.job_logging or hydra.job.name: {error} ({error.__cause__})"
    if isinstance(error, OverrideParseException):
        named = [f"{path.parent.name}={path.stem}" for path in CONF.glob("*/*.yaml") if path.stem == error.override]
        if named:
            return f"{error.override} is no override: {' or '.join(sorted(named))}?"
        if list_of := re.match(r"([\w.]+)=\[", str(error.override)):
            return _explain_list(list_of[1], str(error.override))
        return f"{error.override} is not key=value; a value with = , : ~ or blanks needs two pairs of quotes: \"data_dir='/a=b'\""
    if str(error).startswith(NO_NAME):
        return _explain_no_name(error)
    if match := NO_SWEEP.match(str(error)):
        return _explain_no_sweep(match[1] or match[2])
    if match := IN_A_FILE.match(str(error)):
        return _explain_file(*match.group(1, 2, 3))
    if "Could not override 'confounders'" in str(error):
        return "confounders= does not go with this scenario, which has one grid; it goes with balls and collision"
    if isinstance(error, MissingConfigException) and error.options is not None and error.missing_cfg_file:
        group, _, name = error.missing_cfg_file.rpartition("/")
        options = _splits_of_scenario(error, error.options) if group == "split" else error.options
        choices = ", ".join(sorted(options))
        return f"{group}={name} does not exist{_suggest(name, options)}; there are {choices}{OWN_FOLDER}"
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    if isinstance(cause, MissingMandatoryValue):
        node, block = cause.parent_node, str(cause.full_key).rpartition(".")[0]
        names = (
            [str(key) for key in node if OmegaConf.is_missing(node, key)] if OmegaConf.is_dict(node) else [cause.key]
        )
        missing = "=, ".join(sorted(f"{block}.{name}" if block else str(name) for name in names))
        return f"{missing}= has no value; --help says what it is"
    if isinstance(cause, OmegaConfBaseException) and cause.key is not None:
        what = (cause.msg or str(cause)).splitlines()[0]
        if what.endswith("is not a ListConfig, list or tuple."):
            second = SECOND_NAME.get(str(cause.full_key), "")
            return f"{cause.full_key}={cause.value} must be a list: '{cause.full_key}=[{cause.value}{second}]'"
        if what.startswith(OF_RESOLVER):
            return what.removeprefix(OF_RESOLVER)
        return f"{cause.full_key or cause.key}: {what}{_suggest_key(str(cause.key), cause.parent_node)}"
    return " ".join(line.strip() for line in str(error).splitlines() if line.strip())


def _explain_list(key: str, override: str) -> str:
    if key == "compare" and "=" in override.removeprefix("compare="):
        return f"{override}: no name in this list has =; changes are written as in the names of folders: cophynet+hidden_dim-8"
    return f"{override}: in a list, a name with = : or blanks needs quotes of its own: \"{key}=['a=b',c]\""


def _explain_no_name(error: BaseException) -> str:
    """Return one line for a choice that is a number, as size=640."""
    names = _locals_of(error, "override", "repo")
    group, line = names["override"].key_or_group, names["override"].input_line
    options = names["repo"].get_group_options(group, ObjectType.CONFIG)
    if (value := line.partition("=")[2]) in options:
        return f"{line}: a name that looks like a number needs two pairs of quotes: \"{group}='{value}'\""
    return f"{line} does not exist; there are {', '.join(sorted(options))}{OWN_FOLDER}"


def _explain_no_sweep(override: str) -> str:
    key, _, value = override.partition("=")
    if key.lstrip("+") in LISTS:
        return f"{override}: a list needs brackets: '{key}=[{value}]'"
    return f"{override}: several values are a sweep, a run each: add -m, without --cfg"


def _splits_of_scenario(error: BaseException, options: Iterable[str]) -> list[str]:
    """Return the splits of the chosen scenario, and those of the user; all of them where the scenario cannot be composed."""
    overrides = _locals_of(error, "overrides", "run_mode").get("overrides", [])
    scenario = [word for word in overrides if word.startswith("scenario=")]
    try:
        known = composed("generate", *scenario[-1:]).scenario.task.splits
    except (HydraException, OmegaConfBaseException):
        return [*options]
    return [name for name in options if name in known or not (CONF / "split" / f"{name}.yaml").exists()]


def _locals_of(error: BaseException, *names: str) -> dict[str, Any]:
    """Return the variables of these names in the innermost function that an error came through and that has them all."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    having = (frame.f_locals for frame in reversed(frames) if {*names} <= frame.f_locals.keys())
    found = next(having, {})
    return {name: found[name] for name in names if name in found}


def _explain_slurm(error: BaseException) -> str:
    explanation = next((explanation for text, explanation in SLURM_ERRORS.items() if text in str(error)), "")
    state = re.search(r"\(state: \w+\)", str(error))
    return f"{explanation} {state[0]}" if explanation and state else explanation


def _explain_file(group: str, name: str, what: str) -> str:
    if f"Key '{group}' not in" in what:
        package = PACKAGES.get(group, "_global_").format(group=group, name=name)
        return f"{group}={name}: its YAML must start with the line '# @package {package}'"
    if group not in ("ablation", "row"):
        return f"{group}={name}: {what}"
    remedy = "; ablation=full goes with every model" if group == "ablation" else ""
    file = f" (conf/{group}/{name}.yaml sets it{remedy})" if (CONF / group / f"{name}.yaml").exists() else ""
    return f"{group}={name} does not go with this model: {what}{file}"


def _suggest_key(name: str, node: Any) -> str:
    """Suggest the nearest key in a node, or below it: for `max_epochs`, `trainer.max_epochs`."""
    if not OmegaConf.is_dict(node) or name in node:  # the key is right, its value is not
        return ""
    if (CONF / name).is_dir():
        return f" ({name}= chooses a file of conf/{name}; --help lists the keys)"
    if suggestion := _suggest(name, [str(key) for key in node]):
        return suggestion
    keys = list(_keys_below(node))
    nearest = get_close_matches(name, [key.rpartition(".")[2] for key in keys], n=1)
    matches = dict.fromkeys(_referred(node, key) for key in keys if key.rpartition(".")[2] in nearest)
    return f" (did you mean {' or '.join(matches)}?)" if matches else ""


def _keys_below(node: DictConfig, prefix: str = "") -> Iterator[str]:
    """Yield the keys in the blocks of a node, as `training.optimizer.lr`."""
    for name in map(str, node):
        child = node._get_node(name)
        if isinstance(child, DictConfig) and not child._is_none() and not child._is_missing():
            yield from (f"{prefix}{name}.{key}" for key in map(str, child))
            yield from _keys_below(child, f"{prefix}{name}.")


def _referred(node: DictConfig, key: str) -> str:
    """Return the key that a key only repeats: `training.learning_rate` for `training.optimizer.lr`."""
    parent, _, name = key.rpartition(".")
    match = re.fullmatch(r"\$\{([\w.]+)\}", str(OmegaConf.select(node, parent)._get_node(name)._value()))
    return match[1] if match else key


def _suggest(name: str, known: Iterable[str]) -> str:
    nearest = [match for match in get_close_matches(name, list(known), n=1) if match != name]
    return f" (did you mean {nearest[0]}?)" if nearest else ""


# --help

WIDEST, INDENT = 100, 32
# a comment is "<meaning>; ours: <why this value>", or "<meaning>; paper Sec. 3"; keys without a meaning are not listed
WHY = re.compile(r"(^|[;.] )(ours|paper)\b.*")
SELDOM = "# seldom changed"  # this line hides the keys below it, up to an empty line


def keys_of(file: str, *more: str, _root_: DictConfig) -> str:
    """Return the part of a help text that lists groups with their choices, and keys with their meaning.

    Args:
        file: Name of the YAML in conf/ whose groups and keys are listed.
        more: Further groups, and further keys as "<group>.<key>", which are described in the chosen file of the group.
            "-<group>" leaves a group of the file out.
    """
    added = [name for name in more if not name.startswith("-")]
    current = _root_.hydra.runtime.choices
    choices = []
    for group in [*_groups(file), *(name for name in added if "." not in name)]:
        options = GlobalHydra.instance().config_loader().get_group_options(group.lstrip("+"), ObjectType.CONFIG)
        if len(options) > 1 and f"-{group}" not in more:
            choices += _entry(f"{group}={_plain(current.get(group, ''))}", ", ".join(options))
    meanings = read_meanings(file)
    for name in (name for name in added if "." in name):
        group, _, key = name.partition(".")
        meanings[name] = read_meanings(f"{group}/{current[group]}")[key]
    lines = ["Choices:", *choices, "", "Keys:"] if choices else ["Keys:"]
    for key, meaning in meanings.items():
        lines += _entry(f"{key}={_value(_root_, key)}", meaning)
    lines += ["", "All keys: --cfg job. Hydra's own options: --hydra-help."]
    return "\n".join(lines).replace("$", "$$")  # Hydra fills the help text as a string.Template


OmegaConf.register_new_resolver("keys_of", keys_of, replace=True)


def read_meanings(file: str) -> dict[str, str]:
    """Return the keys of conf/<file>.yaml whose comment explains them, with the explanation; nested keys as "block.key"."""
    text = (CONF / f"{file}.yaml").read_text(encoding="utf-8")
    text = re.sub(rf"^ *{SELDOM}.*?(\n\n|\Z)", "\n", text, flags=re.MULTILINE | re.DOTALL)
    block = yaml.compose(text)
    assert isinstance(block, yaml.MappingNode)
    return {key: meaning for key, meaning in _read_comments(block, text.splitlines(), "") if meaning}


def _read_comments(block: yaml.MappingNode, lines: list[str], prefix: str) -> Iterator[tuple[str, str]]:
    for key, value in block.value:
        if isinstance(value, yaml.MappingNode) and not value.flow_style and key.value != "hydra":
            yield from _read_comments(value, lines, f"{prefix}{key.value}.")
        elif isinstance(value, yaml.ScalarNode) or value.flow_style:
            rest = lines[value.end_mark.line][value.end_mark.column :].strip()
            yield f"{prefix}{key.value}", WHY.sub("", rest.removeprefix("#").strip())


def _groups(file: str) -> list[str]:
    """Return the groups in the defaults list of conf/<file>.yaml."""
    entries = yaml.safe_load((CONF / f"{file}.yaml").read_text(encoding="utf-8"))["defaults"]
    names = [name for entry in entries if isinstance(entry, dict) for name in entry]
    return [name for name in names if not name.startswith(("schema/", "override ", "optional "))]


def _value(config: DictConfig, key: str) -> str:
    parent, _, name = key.rpartition(".")
    block = OmegaConf.select(config, parent) if parent else config
    return "???" if OmegaConf.is_missing(block, name) else _plain(block[name])


def _plain(value: Any) -> str:
    """Return a value as it is written on the command line."""
    if OmegaConf.is_config(value):
        value = OmegaConf.to_container(value, enum_to_str=True)
    if isinstance(value, Enum):
        return value.name
    return value if isinstance(value, str) else json.dumps(value).replace('"', "").replace(" ", "")


def _entry(name: str, text: str) -> list[str]:
    """Return the lines of a name with a text next to it."""
    width = min(shutil.get_terminal_size((WIDEST, 0)).columns, WIDEST)
    lines = wrap(text, width - INDENT) or [""]
    if len(name) > INDENT - 4:
        return [f"  {name}", *(" " * INDENT + line for line in lines)]
    return [f"{f'  {name}':{INDENT}}{lines[0]}".rstrip(), *(" " * INDENT + line for line in lines[1:])]
