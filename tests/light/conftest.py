"""Fixtures of the light."""

from __future__ import annotations

import pytest
from device import DEVICES, Device, open_device


@pytest.fixture(scope="module", params=DEVICES)
def device(request: pytest.FixtureRequest) -> Device:
    return open_device(request.param)
