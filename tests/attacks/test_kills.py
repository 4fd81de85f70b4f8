"""Commands that are killed at random moments go on, by the same command, to the same bytes and metrics."""

import logging
import random
import signal
import time
from pathlib import Path

import pytest

from tests.attacks.processes import end, finish, started
from tests.attacks.world import STEPS, contents, copied

log = logging.getLogger(__name__)
WAYS = ("kill", "kill all", "terminate", "interrupt")  # of its processes: the first or all
SIGNALS = {"kill": signal.SIGKILL, "kill all": signal.SIGKILL, "terminate": signal.SIGTERM, "interrupt": signal.SIGINT}


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(STEPS)), ids=[step.name for step in STEPS])
def test_a_killed_command_goes_on_to_the_same(number: int, worlds: list[Path], tmp_path: Path, attacks: int) -> None:
    step, chance = STEPS[number], random.Random(number)
    world, said = copied(worlds[number], tmp_path / "world"), tmp_path / "said.log"  # as the steps before left it
    seconds = finish(step, world, said)
    expected = contents(world)
    for attack in range(attacks):
        if attack % 3 == 0:  # every third begins anew, the others with what the last one left
            copied(worlds[number], world)
        way, moment = chance.choice(WAYS), seconds * chance.uniform(0.2, 1.0)
        with started(step, world, said) as process:
            time.sleep(moment)
            end(process, SIGNALS[way], everybody=way in {"kill all", "interrupt"})
            if way in {"terminate", "interrupt"}:
                process.wait(timeout=60)
            time.sleep(chance.choice([0, 0.2]))
        text = said.read_text()
        log.info("%s: %s after %.1f of %.1f s: %s", step.name, way, moment, seconds, text.strip()[-200:])
        assert way == "kill" or "Traceback" not in text, text[-3000:]  # its workers lose it, and say so
        if attack % 3 == 2 or attack == attacks - 1:
            finish(step, world, said)
            assert contents(world) == expected
