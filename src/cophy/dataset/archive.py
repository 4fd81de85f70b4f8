"""Finished datasets that are copied instead of generated: from the package, a folder, a zip archive, or a URL of an archive.

All hold `<scenario>/<id>/` with the manifest and the shards of a dataset, as a data directory does. Nothing in them is trusted:
only files of a dataset are read, by their own names, each up to the size that it may have and under the SHA-256 of the manifest.
"""

import errno
import hashlib
import io
import json
import shutil
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import cophy
from cophy.atomic_files import appearing_whole
from cophy.dataset.cards import CARD, TEST_TWINS
from cophy.dataset.shards import MANIFEST, VERSIONS, DamagedShardError, ShardSet, check_plain
from cophy.errors import CophyError, printable

PACKAGE = Path(cophy.__file__).parent / "sample"  # size=sample
MAX_MANIFEST = 16 << 20  # bytes; ours: a hundred thousand shards
MAX_DOWNLOAD = 64 << 30  # bytes; ours: twenty times all states of size=paper
PART = 1 << 20  # bytes that are read at once
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # which unpack in little memory
DESCRIBING = (MANIFEST, CARD, TEST_TWINS)  # files of a dataset next to its shards
DATE = (1980, 1, 1, 0, 0, 0)  # of every file in an archive, so that equal datasets give equal archives
# what zipfile raises on damaged archives
DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, DamagedShardError)


@dataclass(frozen=True)
class Files:
    """Finished sets of shards somewhere else.

    title: name of the folder or archive. sets: folders of the sets, as in a data directory. open: opens a file by its path.
    """

    title: str
    sets: list[str]
    open: Callable[[str], IO[bytes]]

    def __contains__(self, shards: ShardSet) -> bool:
        return str(shards.place) in self.sets


def files_in_package(shards: ShardSet) -> Files | None:
    """Return the files of the package if this set is among them."""
    files = _files_in(PACKAGE)
    return files if shards in files else None


def is_available(shards: ShardSet, files: Files | None = None) -> bool:
    """Return whether a set is finished, or can be copied from the package or these files."""
    return shards.is_finished() or files_in_package(shards) is not None or (files is not None and shards in files)


def _files_in(folder: Path) -> Files:
    def open_plain(name: str) -> IO[bytes]:
        check_plain(folder / name)
        return open(folder / name, "rb")

    manifests = sorted([*folder.glob(f"*/*/{MANIFEST}"), *folder.glob(f"*/*/*/{MANIFEST}")])
    return Files(str(folder), [path.parent.relative_to(folder).as_posix() for path in manifests], open_plain)


@contextmanager
def opened(root: str, data_dir: Path) -> Iterator[Files]:
    """Open a folder, a zip archive, or the URL of one, which is downloaded to a temporary file in `data_dir`.

    Raises:
        CophyError: It cannot be read.
    """
    if Path(root).is_dir():
        yield _files_in(Path(root))
        return
    with ExitStack() as stack:
        try:
            if "://" in root:
                file: IO[bytes] = stack.enter_context(TemporaryFile(dir=data_dir))
                _download(root, file)
            else:
                check_plain(Path(root))
                file = stack.enter_context(open(root, "rb"))
            archive = stack.enter_context(zipfile.ZipFile(_Bounded(file.fileno(), closefd=False)))
        except (*DAMAGE, FileNotFoundError) as error:
            raise CophyError(f"{root} is no archive of a dataset, or damaged: {printable(str(error))}") from error
        yield _files_of(archive, root)


class _Bounded(io.FileIO):
    """A file of which zipfile reads little at once: its list of contents is read whole."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > PART:
            raise zipfile.BadZipFile("its list of files is too long")
        return super().read(size) or b""


def _files_of(archive: zipfile.ZipFile, title: str) -> Files:
    def open_member(name: str) -> IO[bytes]:
        try:
            member = archive.getinfo(name)
        except KeyError as error:
            raise zipfile.BadZipFile(f"it has no {name}") from error
        if member.compress_type not in METHODS:
            raise zipfile.BadZipFile(f"{name} is neither stored nor deflated")
        return archive.open(member)

    ending = f"/{MANIFEST}"
    sets = [name.removesuffix(ending) for name in archive.namelist() if name.endswith(ending)]
    return Files(title, sets, open_member)


def _download(url: str, target: IO[bytes]) -> None:
    import fsspec

    stream = {"block_size": 0} if url.startswith("http") else {}  # a server may know no ranges
    try:
        with fsspec.open(url, "rb", **stream) as source:
            _copy(source, target, MAX_DOWNLOAD)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise
        raise CophyError(f"{url} cannot be read: {printable(str(error))}") from error
    except Exception as error:  # of the libraries of a protocol, each its own
        raise CophyError(f"{url} cannot be read: {printable(str(error)) or type(error).__name__}") from error


def _copy(source: IO[bytes], target: IO[bytes], most: int) -> str:
    """Copy a stream of at most `most` bytes and return its SHA-256."""
    digest, size = hashlib.sha256(), 0
    while part := source.read(PART):
        size += len(part)
        if size > most:
            raise DamagedShardError(f"it has more than {most} bytes")
        digest.update(part)
        target.write(part)
    target.flush()
    return digest.hexdigest()


def copy_shards(missing: Sequence[int], shards: ShardSet, files: Files) -> dict[str, str]:
    """Copy shards of a set and compare each with its checksum.

    Returns:
        The versions of the libraries that wrote them.

    Raises:
        CophyError: There are other datasets, or they are damaged.
    """
    if shards not in files:
        others = ", ".join(printable(name) for name in files.sets[:10]) or "no dataset"
        raise CophyError(
            f"{files.title} has {others}, not {shards.place}: choose with size=, num_objects= and data_seed=; data of an "
            "earlier format cannot be read, generate them again"
        )
    name = MANIFEST
    try:
        content = io.BytesIO()
        with files.open(f"{shards.place}/{name}") as source:
            _copy(source, content, MAX_MANIFEST)
        manifest = json.loads(content.getvalue())
        checksums = {shard: manifest["shards"][shards.path(shard).name] for shard in missing}
        versions = {library: str(manifest["versions"].get(library, "unknown"))[:50] for library in VERSIONS}
        for shard in missing:
            name = shards.path(shard).name
            with files.open(f"{shards.place}/{name}") as source, appearing_whole(shards.path(shard)) as temporary:
                with open(temporary, "wb") as target:
                    checksum = _copy(source, target, shards.max_bytes(shard))
                if checksum != checksums[shard]:
                    raise DamagedShardError(f"its checksum is not the one in {MANIFEST}")
        return versions
    except (*DAMAGE, AttributeError, KeyError, TypeError, ValueError, FileNotFoundError) as error:
        raise CophyError(f"{files.title}: {shards.place}/{name} is damaged ({printable(str(error))})") from error


def write_archive(states: ShardSet, images: ShardSet | None, root: Path) -> Path:
    """Write a finished dataset, and a set of its images if given, as a zip archive below `root`; return its path."""
    path = root / f"{str(states.place).replace('/', '-')}.zip"
    with appearing_whole(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for shards in [states] if images is None else [states, images]:
            checksums = shards.finished_checksums()
            for shard, file in enumerate(shards.paths()):
                with shards.report_damage(shard):
                    shards.verify(shard, checksums[file.name])
            describing = (shards.directory / name for name in DESCRIBING)
            for file in (*shards.paths(), *(path for path in describing if path.exists())):
                member = zipfile.ZipInfo(f"{shards.place}/{file.name}", DATE)
                with open(file, "rb") as source, archive.open(member, "w", force_zip64=True) as target:
                    shutil.copyfileobj(source, target, PART)
    return path
