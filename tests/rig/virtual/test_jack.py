"""The JACK server of a rehearsal: what is missing on the machine is said at once."""

from __future__ import annotations

import sys
import time

import pytest

from daq.setup.errors import InputError
from rig.virtual import jack_server


def test_a_missing_package_is_named_before_any_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without JACK-Client no server is blamed, or waited for: the error says what to install."""
    monkeypatch.setitem(sys.modules, "jack", None)
    began = time.monotonic()
    with pytest.raises(InputError, match=r"pip install 'shakerbench\[jack\]'"), jack_server("none", 48000.0, 256):
        pass
    assert time.monotonic() - began < 5.0
