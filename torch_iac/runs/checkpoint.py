"""Checkpoints, from which a run goes on bit for bit.

    checkpoints/000000010000/state.safetensors   all tensors of the agents, the world and the loop
    checkpoints/000000010000/state.json          where they belong, and what is no tensor
    checkpoints/000000010000/manifest.json       the run's identity; sizes and hashes of the others
    checkpoints/LATEST                           which one is the last, and its manifest's hash

A checkpoint is written under a temporary name, fsynced and renamed, and only then named in
`LATEST`, so that at every moment a whole one is there. Files are not trusted: nothing in them is
ever executed, and any change to them is detected.
"""

import re
import shutil
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from torch_iac.agent import IAC
from torch_iac.internal.files import (
    dump_json,
    parse_json,
    remove_temporary,
    replace,
    sync,
    sync_names,
)
from torch_iac.internal.serialize import pack, unpack
from torch_iac.internal.state import State

FORMAT = 2
"""Which checkpoints this version writes and reads: it rises when runs would go on otherwise than
they began, or when the files change. Versions of the library do not matter."""

ADDED: Mapping[str, Any] = {}
"""Names in the identity that later versions added, each with what it was before there was a choice:
checkpoints without them go on."""

STATE, CONTENT, MANIFEST, LATEST = "state.safetensors", "state.json", "manifest.json", "LATEST"
"""What the files are called."""

PARTS = ("agent", "world", "loop")
"""What a checkpoint holds: fields of `Checkpoint`."""

LONGEST_MANIFEST = 2**26
"""Largest size of a manifest, in bytes."""

_NAME = re.compile(r"(\d{12,18})(?:-(\d{1,9}))?")
_TEMPORARY = re.compile(rf"\.{_NAME.pattern}\.tmp")


@dataclass(frozen=True)
class Checkpoint:
    """A run between two decisions.

    The world's and the loop's parts may be whatever `serialize` can pack: dicts, lists and tuples
    of arrays, tensors, numbers and text, as the worlds' `get_state` returns them.

    Attributes:
        n_decisions: How many decisions were taken.
        agent: What `IAC.state` returned.
        world: What the world returned, if it can be resumed.
        loop: What the loop needs besides, such as the last sensors.
    """

    n_decisions: int
    agent: State
    world: Any = None
    loop: Any = None


def identity(agent: IAC, **more: Any) -> dict[str, Any]:
    """Return what must be the same, as JSON can hold it, for a checkpoint to fit.

    Args:
        agent: The population.
        more: What else must be the same, such as the world's name and options.
    """
    return {
        "space": agent.space.to_json(),
        "config": agent.config.to_json(),
        "seeds": list(agent.seeds),
        **more,
    }


class Checkpoints:
    """The checkpoints of a run, of which the last two are kept.

    Args:
        folder: Where they are, such as `checkpoints` in the run's folder; made when it is needed.
        identity: What must be the same for a checkpoint to fit, as JSON can hold it.

    Raises:
        TypeError: JSON cannot hold the identity.
        ValueError: A number in it is not finite.
    """

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        self.folder = Path(folder)
        self._identity = parse_json(dump_json(identity))
        self._sound: Path | None = None  # the last that was written or read

    def write(self, checkpoint: Checkpoint) -> Path:
        """Write a checkpoint, make it the latest and remove all but it and the one before.

        Returns:
            Its folder.

        Raises:
            OSError: It cannot be written; those before it are untouched.
            TypeError: The world or the loop has state that cannot be packed.
            ValueError: A number in it is not finite.
        """
        before = self._sound or self._latest()
        files = self._files(checkpoint)
        self._make_ready()
        folder = self._free(checkpoint.n_decisions)
        temporary = self.folder / f".{folder.name}.tmp"
        try:
            _write_folder(temporary, files)
        except OSError:
            shutil.rmtree(temporary, ignore_errors=True)  # frees space on a full disk
            raise
        temporary.rename(folder)
        sync_names(self.folder)
        line = _line(folder.name, files[MANIFEST])
        replace(self.folder / LATEST, lambda path: path.write_text(line))
        self._sound = folder
        for old in self._newest_first():
            if old not in (folder, before):
                shutil.rmtree(old, ignore_errors=True)  # the rest is removed the next time
        return folder

    def read(self, n_decisions: int | None = None) -> Checkpoint:
        """Return the latest sound checkpoint; a warning says if it is not the latest of all.

        Args:
            n_decisions: After how many decisions it must be; None for the latest.

        Raises:
            FileNotFoundError: There is no checkpoint, or none after so many decisions.
            ValueError: It is another version's or another run's, or none is sound.
        """
        latest = self._latest()
        found = [latest] if latest else []
        found += [folder for folder in self._newest_first() if folder != latest]
        if n_decisions is not None:
            numbers = {folder: int(folder.name.partition("-")[0]) for folder in found}
            found = [folder for folder in found if numbers[folder] == n_decisions]
            if not found:
                there = ", ".join(str(number) for number in sorted(set(numbers.values()))) or "none"
                raise FileNotFoundError(
                    f"{self.folder} must hold a checkpoint after {n_decisions} decisions, "
                    f"got {there}"
                )
        damages = []
        if latest is None and (self.folder / LATEST).exists():
            damages.append(f"{LATEST} must name a checkpoint that is there")
        for folder in found:
            try:
                manifest, checkpoint = _read_folder(folder)
            except _DamageError as damage:
                damages.append(f"{folder.name}/{damage}")
                continue
            self._check_fits(folder, manifest)
            if damages:
                warnings.warn(
                    f"{self.folder} is damaged, going on from {folder.name}: {'; '.join(damages)}",
                    stacklevel=2,
                )
            self._sound = folder
            return checkpoint
        if found:
            raise ValueError(f"{self.folder} holds no sound checkpoint: {'; '.join(damages)}")
        raise FileNotFoundError(f"{self.folder} holds no checkpoint")

    def _files(self, checkpoint: Checkpoint) -> dict[str, bytes]:
        tensors, content = pack({name: getattr(checkpoint, name) for name in PARTS})
        files = {STATE: save(tensors), CONTENT: dump_json(content)}
        manifest = {
            "format": FORMAT,
            "n_decisions": checkpoint.n_decisions,
            "torch": torch.__version__,
            "identity": self._identity,
            "files": {
                name: {"size": len(data), "sha256": sha256(data).hexdigest()}
                for name, data in files.items()
            },
        }
        return {**files, MANIFEST: _sealed(manifest)}

    def _make_ready(self) -> None:
        if not self.folder.is_dir():
            self.folder.mkdir(parents=True)
            sync_names(self.folder.parent)
        for path in self.folder.iterdir():
            if _TEMPORARY.fullmatch(path.name):  # left by a run that was killed
                shutil.rmtree(path, ignore_errors=True)
        remove_temporary(self.folder)

    def _free(self, n_decisions: int) -> Path:
        """Return a folder that is not there yet: nothing valid is ever overwritten."""
        folder, attempt = self.folder / f"{n_decisions:012d}", 0
        while folder.exists():
            attempt += 1
            folder = self.folder / f"{n_decisions:012d}-{attempt}"
        return folder

    def _newest_first(self) -> list[Path]:
        if not self.folder.is_dir():
            return []
        found = {}
        for path in self.folder.iterdir():
            name = _NAME.fullmatch(path.name)
            if name and path.is_dir() and not path.is_symlink():
                found[path] = (int(name[1]), int(name[2] or 0))
        return sorted(found, key=found.__getitem__, reverse=True)

    def _latest(self) -> Path | None:
        """Return the checkpoint that `LATEST` names, if its manifest is the one that it means."""
        try:
            line = _read(self.folder / LATEST, 200).decode("ascii", errors="replace")
        except _DamageError:
            return None
        for folder in self._newest_first():
            try:
                if line == _line(folder.name, _read(folder / MANIFEST, LONGEST_MANIFEST)):
                    return folder
            except _DamageError:
                continue
        return None

    def _check_fits(self, folder: Path, manifest: Mapping[str, Any]) -> None:
        saved, present = _leaves(manifest["identity"]), _leaves(self._identity)
        present = {n: of for n, of in present.items() if n in saved or ADDED.get(n, ...) != of}
        for name in [*saved, *(name for name in present if name not in saved)]:
            old, new = saved.get(name, "nothing"), present.get(name, "nothing")
            if (type(old) is bool, old) != (type(new) is bool, new):
                raise ValueError(f"{name} must be {old} as in the checkpoint {folder}, got {new}")
        if list(saved) != list(present):
            old, new = next(pair for pair in zip(saved, present, strict=True) if len({*pair}) > 1)
            raise ValueError(f"{new} must not come before {old}, as in the checkpoint {folder}")
        if manifest["torch"] != torch.__version__:
            warnings.warn(
                f"{folder} was written with torch {manifest['torch']}: with {torch.__version__} "
                "the last digits may differ",
                stacklevel=3,
            )


class _DamageError(ValueError):
    """A file was changed after it was written."""


def _write_folder(folder: Path, files: Mapping[str, bytes]) -> None:
    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)
        sync(folder / name)
    sync_names(folder)


def _read_folder(folder: Path) -> tuple[dict[str, Any], Checkpoint]:
    """Return a checkpoint and its manifest.

    Raises:
        _DamageError: A file is missing, not as it was written, or not what a checkpoint holds.
        ValueError: The format is another version's.
    """
    manifest = _read_manifest(folder / MANIFEST)
    files = {}
    for name in (STATE, CONTENT):
        size, digest = (manifest["files"][name][key] for key in ("size", "sha256"))
        files[name] = data = _read(folder / name, size)
        if len(data) != size or sha256(data).hexdigest() != digest:
            raise _DamageError(f"{name} must be as it was written, got other bytes")
    content = _read_content(files[CONTENT], _read_tensors(files[STATE]))
    return manifest, Checkpoint(n_decisions=manifest["n_decisions"], **content)


def _read_manifest(path: Path) -> dict[str, Any]:
    data = _read(path, LONGEST_MANIFEST)
    try:
        manifest = parse_json(data)
    except ValueError as error:
        raise _DamageError(f"{path.name}: {error}") from None
    if not isinstance(manifest, dict) or data != _sealed(manifest):
        raise _DamageError(f"{path.name} must be as it was written, got other bytes")
    if manifest.get("format") != FORMAT:
        raise ValueError(
            f"format must be {FORMAT} for this version to read {path}, got {manifest.get('format')}"
        )
    files = {STATE: {"size": int, "sha256": str}, CONTENT: {"size": int, "sha256": str}}
    kinds = {"n_decisions": int, "torch": str, "identity": dict, "files": files}
    if not _is_like(manifest, {"format": int, **kinds, "sha256": str}):
        raise _DamageError(f"{path.name} must name {', '.join(kinds)}, got something else")
    return manifest


def _is_like(content: Any, pattern: Any) -> bool:
    """Return whether JSON has the names and the types of a pattern."""
    if not isinstance(pattern, dict):
        return type(content) is pattern
    return (
        isinstance(content, dict)
        and content.keys() == pattern.keys()
        and all(_is_like(content[name], kind) for name, kind in pattern.items())
    )


def _read_tensors(data: bytes) -> dict[str, Tensor]:
    try:
        tensors: dict[str, Tensor] = load(data)
        return tensors
    except (
        SafetensorError,
        AssertionError,
        LookupError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        raise _DamageError(f"{STATE} must hold tensors: {error}") from None


def _read_content(data: bytes, tensors: Mapping[str, Tensor]) -> dict[str, Any]:
    try:
        parts = unpack(tensors, parse_json(data))
    except ValueError as error:
        raise _DamageError(f"{CONTENT}: {error}") from None
    if not isinstance(parts, dict) or parts.keys() != set(PARTS):
        raise _DamageError(f"{CONTENT} must hold {', '.join(PARTS)}, got something else")
    agent = parts["agent"]
    if not isinstance(agent, dict) or not all(isinstance(t, Tensor) for t in agent.values()):
        raise _DamageError(f"{CONTENT} must name the agents' tensors, got something else")
    return parts


def _read(path: Path, limit: int) -> bytes:
    """Return the bytes of a regular file, `limit` at most."""
    try:
        if not path.is_file():  # reading a pipe would block
            raise _DamageError(f"{path.name} must be a file, got none")
        if path.stat().st_size > limit:
            raise _DamageError(f"{path.name} must hold at most {limit} bytes, got more")
        return path.read_bytes()
    except OSError as error:
        raise _DamageError(f"{path.name} must be readable: {error}") from None


def _sealed(manifest: Mapping[str, Any]) -> bytes:
    """Return a manifest as it is written: as the last, its own sha256."""
    content = {name: value for name, value in manifest.items() if name != "sha256"}
    return dump_json({**content, "sha256": sha256(dump_json(content)).hexdigest()})


def _line(name: str, manifest: bytes) -> str:
    """Return what `LATEST` says of a checkpoint."""
    return f"{name} {sha256(manifest).hexdigest()}\n"


def _leaves(content: Any, name: str = "") -> dict[str, Any]:
    """Return the numbers and texts of JSON by where they are, such as `config.epsilon`."""
    if not isinstance(content, (dict, list)) or not content:
        return {name: content}
    parts = content.items() if isinstance(content, dict) else enumerate(content)
    leaves: dict[str, Any] = {}
    for key, part in parts:
        leaves |= _leaves(part, f"{name}.{key}" if name else str(key))
    return leaves
