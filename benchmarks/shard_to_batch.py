"""From a shard to a batch: the functions of cophy that are entered, and their files.

Loads the tiny collisions under a profile hook, from CounterfactualDataModule.setup to the first training batch, with true
confounders, object types and poses.

    python benchmarks/shard_to_batch.py data
"""

import inspect
import sys
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from path_to_fit import PACKAGE, num_lines, outermost

from cophy.config import settings
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.schemas import register


def main() -> None:
    """Print the counts."""
    register()
    config = settings("train", "scenario=collision", "size=tiny")
    (states,) = config.source.experiment_sets(
        config.scenario, config.split, None, size=config.size, data_seed=0, data_dir=Path(sys.argv[1])
    )
    data = CounterfactualDataModule(
        config.split,
        train_set=states,
        test_set=states,
        batch_size=8,
        workers=1,
        declared=("confounders", "object_type", "pose"),
    )
    data.prepare_data()
    codes: set[CodeType] = set()

    def hook(frame: FrameType, event: str, argument: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(str(PACKAGE)) and code.co_flags & inspect.CO_OPTIMIZED:
            codes.add(code)

    sys.setprofile(hook)
    data.setup()
    next(iter(data.train_dataloader()))
    sys.setprofile(None)
    functions = outermost(codes)
    files = {code.co_filename for code in functions}
    print(f"{len(functions)} functions, {sum(map(num_lines, functions))} lines, {len(files)} files")


if __name__ == "__main__":
    main()
