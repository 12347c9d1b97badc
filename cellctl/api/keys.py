"""Keys of machines and people that work with a real cell: random, kept as hashes, one file.

A key has 256 random bits, so that a plain SHA-256 of it gives nothing to guess at; it is shown once, when it is made.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import logging
import os
import secrets
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cellctl.api.auth import Principal, Role
from cellctl.whole_file import whole_file
from hal.errors import ConfigError

KEY_BYTES = 32
OTHERS = stat.S_IRWXG | stat.S_IRWXO
_log = logging.getLogger(__name__)


class Key(BaseModel):
    """Whose key it is, what its holder may do, and the SHA-256 of the key."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    role: Role
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class _File(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    keys: tuple[Key, ...]


class KeyAuth:
    """`cellctl.api.auth.Authenticator` over a file of keys. What changes in the file holds from the next request on.

    Raises ConfigError where the file is none; one that becomes none later lets nobody in.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._mark: object = None
        self._keys = load_keys(path)

    def principal(self, token: str) -> Principal | None:
        """Compared in constant time, with every key every time."""
        self._look()
        told, found = hash_of(token), None
        for key in self._keys:
            if hmac.compare_digest(key.sha256, told):
                found = Principal(key.name, key.role)
        return found

    def _look(self) -> None:
        try:
            now = self._path.stat()
            mark: object = (now.st_ino, now.st_mtime_ns, now.st_ctime_ns, now.st_size)
        except OSError as error:
            mark = error.errno
        if mark == self._mark:
            return
        self._mark = mark
        try:
            self._keys = load_keys(self._path)
        except ConfigError as error:
            _log.error("nobody is let in: %s", error)
            self._keys = ()


def hash_of(key: str) -> str:
    """What is kept of a key: hexadecimal SHA-256."""
    return hashlib.sha256(key.encode("utf-8", "replace")).hexdigest()


def load_keys(path: Path) -> tuple[Key, ...]:
    """The keys of a file. Raises ConfigError where it cannot be read, is none, or others than its owner may read it."""
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            text = file.read()
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}; `cellctl keys add` makes it", place=str(path)) from None
    if mode & OTHERS:
        raise ConfigError(f"others may read it or write to it: mode {mode & 0o777:o}", place=str(path), limit="600")
    try:
        keys = _File.model_validate_json(text).keys
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        where = ".".join([path.name, *map(str, first["loc"])])
        raise ConfigError(first["msg"], place=where) from None
    names = [key.name for key in keys]
    if double := sorted({name for name in names if names.count(name) > 1}):
        raise ConfigError(f"two keys have the name {double[0]}", place=str(path))
    return keys


def add_key(path: Path, name: str, role: Role) -> str:
    """Make a key, keep its hash, give the key. Raises ConfigError where name or file is not fit for it, OSError."""
    keys = load_keys(path) if path.exists() else ()
    if name in {key.name for key in keys}:
        raise ConfigError(f"{name} has a key already: remove it first", place=str(path))
    key = secrets.token_urlsafe(KEY_BYTES)
    try:
        kept = Key(name=name, role=role, sha256=hash_of(key))
    except ValidationError:
        raise ConfigError("letters, digits, . _ - only, 64 at most", place=f"name {name!r}") from None
    save_keys(path, (*keys, kept))
    return key


def remove_key(path: Path, name: str) -> None:
    """Its holder is let in no more. Raises ConfigError where there is none of that name, OSError."""
    keys = load_keys(path)
    left = tuple(key for key in keys if key.name != name)
    if len(left) == len(keys):
        raise ConfigError(f"{name} has no key", place=str(path))
    save_keys(path, left)


def save_keys(path: Path, keys: Sequence[Key]) -> None:
    """Write the file whole, for its owner only. Raises OSError."""
    told = {"keys": [key.model_dump(mode="json") for key in keys]}
    with whole_file(path, mode=0o600) as file:
        file.write((json.dumps(told, indent=2) + "\n").encode())
