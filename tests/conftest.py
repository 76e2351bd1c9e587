"""Shared fixtures: where the surveys lie, and skipping, with the reason, where they do not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("GEOMAG_DATA", ROOT.parent / "shared" / "data"))


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the surveys beside the project (or GEOMAG_DATA)."""
    if not SHARED.is_dir():
        pytest.skip(f"no survey data at {SHARED}; set GEOMAG_DATA to the folder that holds them")
    return SHARED


@pytest.fixture(scope="session")
def data_file(data: Path):
    """Return a function from a path under the data folder to the file, skipping where it is absent."""

    def find(relative: str) -> Path:
        path = data / relative
        if not path.exists():
            pytest.skip(f"survey file {relative} is not in {data}")
        return path

    return find
