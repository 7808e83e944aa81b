"""Fixtures of the part."""

from __future__ import annotations

import pytest
from maps import polished, write_sur


@pytest.fixture
def folder(tmp_path):
    heights, missing = polished()
    write_sur(tmp_path / "x.sur", heights, missing=missing)
    return tmp_path
