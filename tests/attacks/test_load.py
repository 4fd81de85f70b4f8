"""Eight commands at once on the same data and runs end as they do alone."""

from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.attacks.processes import finish, started
from tests.attacks.world import DATA, STEPS, TRAINING, Step, contents, copied

KNOWN = {step.name: step for step in STEPS}
TOGETHER = (
    KNOWN["generate"],
    KNOWN["render"],
    KNOWN["train"],
    Step("in", "train", (*DATA, *TRAINING, "model=in", "trainer.max_epochs=2")),
    Step("copy", "train", (*DATA, *TRAINING, "model=copy_b")),
    Step("audit", "audit", (*DATA, "replayed_pairs=1", "directory={world}/audit")),
    KNOWN["export"],
    KNOWN["look"],
)


@pytest.mark.slow
@pytest.mark.parametrize("begins", [0, 1], ids=["without data", "with states"])
def test_commands_at_once_end_as_alone(begins: int, worlds: list[Path], tmp_path: Path) -> None:
    world = copied(worlds[begins], tmp_path / "world")
    for step in TOGETHER:
        finish(step, world, tmp_path / "alone.log")
    expected = contents(world)
    copied(worlds[begins], world)
    with ExitStack() as stack:
        logs = [tmp_path / f"{step.name}.log" for step in TOGETHER]
        running = [stack.enter_context(started(step, world, log)) for step, log in zip(TOGETHER, logs, strict=True)]
        codes = [process.wait(timeout=600) for process in running]
    said = [log.read_text()[-1000:] for log in logs]
    assert "Traceback" not in "".join(said), said
    if begins == 0:  # what has no data yet says so, or waits until they are there
        assert all(code == 0 or "run `python src/generate.py" in text for code, text in zip(codes, said, strict=True))
        for step, code in zip(TOGETHER, codes, strict=True):
            if code != 0:
                finish(step, world, tmp_path / "again.log")
    else:
        assert codes == [0] * len(TOGETHER), said
    finish(KNOWN["report"], world, tmp_path / "report.log")
    found = contents(world)
    assert {name: found[name] for name in expected} == expected
