"""Run a command; what the user can mend ends it with one line: what is wrong, where, and the nearest right spelling."""

import errno
import json
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from functools import wraps
from pathlib import Path
from typing import Any
from uuid import uuid4

from hydra._internal import defaults_list
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, MissingConfigException
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from cophy.app import key_help  # noqa: F401  the resolver of help texts
from cophy.app.composition import CONF
from cophy.errors import SAFE, CophyError
from cophy.training.runs.identity import FAILURE, SWEEP

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
