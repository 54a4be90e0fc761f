"""Memory that was freed goes back to the system."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from typing import Final

import pytest

PROGRAM: Final = """
import os
from auv_mcm.memory import return_freed_memory

def resident_bytes():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

planes = [bytearray(b"1" * 100_000) for _ in range(300)]
last = bytearray(b"1" * 100_000)  # lies behind them, so that the heap cannot shrink by itself
del planes
before = resident_bytes()
return_freed_memory()
print(before - resident_bytes())
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="this C library keeps what was freed")
def test_memory_freed_in_the_middle_of_the_heap_goes_back_to_the_system() -> None:
    returned = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True).stdout
    assert int(returned) > 20_000_000
