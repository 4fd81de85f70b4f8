"""A disk that refuses writes while HDF5 has a file open: an error with its number, and the process lives on."""

import errno
from pathlib import Path

import pytest

from tests.commands import python

SCRIPT = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from cophy.atomic_files import appearing_whole
from cophy.dataset.shards import Field, create_file
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
fields = {"rgb": Field((32, 64, 64, 3), "u1", storage={"chunks": (1, 64, 64, 3), "compression": "gzip"})}
try:
    with appearing_whole(Path(sys.argv[1])) as path, create_file(path, fields, {}) as arrays:
        for row in range(32):
            arrays["rgb"][row] = np.random.default_rng(row).integers(0, 256, (64, 64, 3))
except OSError as error:
    print(error.errno, error.strerror, error.filename)
"""


@pytest.mark.parametrize("limit", [100, 3000, 60_000, 390_000])
def test_an_error_while_hdf5_writes_ends_nothing_else(limit: int, tmp_path: Path) -> None:
    path = tmp_path / "shard.h5"
    done = python("-c", SCRIPT, path, limit)
    assert (done.stdout, done.stderr) == (f"{errno.EFBIG} File too large {path}\n", "")
    assert list(tmp_path.iterdir()) == []
