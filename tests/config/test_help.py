"""`--help` fits a screen and shows the comments of the YAML."""

import re
from pathlib import Path

import pytest

from cophy.cli import read_meanings
from tests import commands
from tests.conftest import ROOT

MAX_LINES, WIDTH = 48, 100
NAMED = {  # keys and choices that users look for
    "train": ("scenario=blocktower", "split=", "model=cophynet", "ablation=full", "seed=0", "ckpt=null", "+table=",
              "trainer.max_epochs=40", "sphere_to_cylinder", "gt_confounders", "hydra/launcher="),
    "generate": ("scenario=blocktower", "size=small", "num_objects=null", "workers=2", "parts=1"),
    "audit": ("scenario=blocktower", "replayed_pairs=20", "directory=outputs/audit/blocktower"),
    "report": ("outputs=outputs", "directory=outputs/report", "source=generated"),
    "derender": ("derenderer=null", "outputs=outputs", "part=0"),
    "look": ("experiment=4", "num_shown=12", "directory=outputs/look/blocktower"),
    "predict": ("observed=???", "initial=???", "truth=null", "derenderer=???", "predictor=???"),
    "export": ("root=???", "render.resolution=224", "num_objects=null"),
}  # fmt: skip


QUICK = ("train", "generate", "predict")


@pytest.mark.parametrize(
    "command", [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in NAMED]
)
def test_help_is_one_screen_of_keys_with_their_meaning_from_the_yaml(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    lines = commands.run(command, "--help").rstrip().splitlines()
    assert len(lines) <= MAX_LINES
    assert max(map(len, lines)) <= WIDTH
    for name in NAMED[command]:
        assert any(f" {name}" in line for line in lines), name
    assert "--cfg job" in lines[-1]
    assert not [line for line in lines if "$" in line]
    listed, meanings = " ".join(" ".join(lines).partition("Keys:")[2].split()), read_meanings(command)
    for key, meaning in meanings.items():
        assert re.search(rf"{re.escape(key)}=\S+ {re.escape(meaning)}", listed), key
    yaml = (ROOT / "conf" / f"{command}.yaml").read_text()
    assert meanings
    assert all(meaning in yaml for meaning in meanings.values())


def test_help_shows_the_values_that_the_command_would_use() -> None:
    text = commands.run("train", "scenario=balls", "seed=7", "--help")
    assert " scenario=balls " in text
    assert " split=4to4 " in text
    assert " seed=7 " in text


def test_a_comment_is_a_meaning_and_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cophy.cli.CONF", tmp_path)
    (tmp_path / "any.yaml").write_text(
        'a: "#1" # what it is; ours: why\nb: 2 # ours: only why\nc: 3\nd:\n  e: [1, 2] # a list; paper Sec. 3\n'
        "# seldom changed\nf: 4 # hidden\n\ng: 5 # shown again\n"
    )
    assert read_meanings("any") == {"a": "what it is", "d.e": "a list", "g": "shown again"}


def test_help_does_not_wait_for_torch() -> None:
    code = (
        "import runpy, sys\n"
        "sys.argv = ['src/train.py', '--help']\n"
        "runpy.run_path('src/train.py', run_name='__main__')\n"
        "assert not {'torch', 'lightning'} & sys.modules.keys()\n"
    )
    assert "Keys:" in commands.python("-c", code, cwd=ROOT).stdout
