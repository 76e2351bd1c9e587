"""A folder of results, from which a run that was interrupted goes on."""

from __future__ import annotations

import hashlib
import json
import os
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from geomag._errors import ReadError, StateError
from geomag.campaign._table import _Part


class _Store:
    """Finished chunks in a folder, each written whole or not at all."""

    def __init__(self, folder: FilePath, fingerprint: dict[str, Any]) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        plan = folder / "campaign.json"
        if plan.exists():
            try:
                held = json.loads(plan.read_text(encoding="utf-8"))
            except (OSError, ValueError) as error:
                raise ReadError(f"{plan}: needed a campaign's settings, got something unreadable ({error})") from error
            if not isinstance(held, dict):
                raise ReadError(f"{plan}: needed a campaign's settings, got {type(held).__name__}")
            if held != fingerprint:
                changed = sorted(k for k in {*held, *fingerprint} if held.get(k) != fingerprint.get(k))
                raise StateError(
                    f"folder {folder}: holds another campaign (differs in {', '.join(changed)}); use another folder"
                )
        else:
            self._write(plan, lambda part: part.write_text(json.dumps(fingerprint, indent=1), encoding="utf-8"))

    @staticmethod
    def _write(target: FilePath, write: Callable[[FilePath], object]) -> None:
        part = target.with_name(f".{target.name}.{os.getpid()}.{time.monotonic_ns()}.part")
        write(part)
        part.replace(target)

    def _path(self, trials: tuple[int, ...]) -> FilePath:
        digest = hashlib.sha256(np.asarray(trials, dtype="<u8").tobytes()).hexdigest()[:12]
        return self.folder / f"trials-{trials[0]:09d}-{trials[-1]:09d}-{digest}.npz"

    def load(self, trials: tuple[int, ...]) -> _Part | None:
        path = self._path(trials)
        if not path.exists():
            return None
        try:
            with np.load(path) as held:
                count = 1 + max(int(name.split("/")[0]) for name in held.files)
                return [
                    {n.split("/", 1)[1]: held[n] for n in held.files if n.startswith(f"{k}/")} for k in range(count)
                ]
        except (OSError, ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise ReadError(f"{path}: needed rows of a campaign, got something unreadable ({error})") from error

    def save(self, trials: tuple[int, ...], part: _Part) -> None:
        arrays: dict[str, Any] = {f"{k}/{name}": v for k, columns in enumerate(part) for name, v in columns.items()}

        def write(path: FilePath) -> None:
            with path.open("wb") as out:
                np.savez(out, **arrays)

        self._write(self._path(trials), write)
