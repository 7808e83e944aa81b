"""PoCL, told what it does not know: to compile once, and the name of a CPU newer than it is.

The wheel's LLVM 14 calls a CPU that it does not know `generic`, which its own clang then refuses
("unknown target CPU 'generic'": pocl issues 512 and 1049). No build flag changes that, and there is
no newer wheel. But the device's structure holds a pointer to the name, read at each build.
"""

from __future__ import annotations

import ctypes
import os
from typing import Any

from gpuspec.host import AVX512, cpu_flags

REPAIRED = "OpenCL 3.0 PoCL 3.0-rc2  Linux, Release, RELOC, LLVM 14.0.6, SLEEF, DISTRO, POCL_DEBUG"
"""The one build of PoCL whose device structure is known: that of pocl-binary-distribution 3.0."""

SWITCH = "GPUSPEC_POCL_CPU"
"""Environment variable: a CPU's name as LLVM has it, to be taken in place of `generic`; "off"."""

_SPECIALISED = "POCL_WORK_GROUP_SPECIALIZATION"
_TRIPLE = b"x86_64-unknown-linux-gnu"
_UNKNOWN = b"generic"
_TRIPLE_WORD, _CPU_WORD = 79, 80  # eight-byte words from the start of struct _cl_device_id

_HASWELL = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe", "popcnt"}
# The first whose instructions, those that compilers choose by themselves, the machine has. LLVM 14
# knows no later AMD than Zen 3, which has no AVX-512: with it kernels run twice as fast on Zen 5.
_NAMES = (
    (b"skylake-avx512", _HASWELL | AVX512),
    (b"znver3", _HASWELL | {"sse4a", "adx", "clzero"}),
    (b"haswell", _HASWELL),
    (b"x86-64", set[str]()),
)

_kept: list[Any] = []  # the device points into these strings for as long as the process lives


def compile_once() -> None:
    """Let PoCL compile a kernel once, and not anew for every number of work-items in a group.

    Each takes it a third of a second or more, for every width of an image and every length of a
    list; what it gains by it is within the noise of measurement. Call it before PoCL is asked for
    its platform; the user's own word on it counts.
    """
    os.environ.setdefault(_SPECIALISED, "0")


def repair(device: Any) -> None:
    """Give a device of PoCL whose compiler does not know its CPU the name of an older CPU.

    Does nothing unless version, triple and the word `generic` are all as expected. That it helped
    is for the device's proof to say, see :mod:`gpuspec.light.proof`.

    Parameters
    ----------
    device : pyopencl.Device
        Before anything is built on it.
    """
    if device.platform.version != REPAIRED:
        return
    words = _at(device, _TRIPLE_WORD), _at(device, _CPU_WORD)
    wanted = os.environ.get(SWITCH, "")
    if wanted == "off" or words != (_TRIPLE, _UNKNOWN):
        return
    name = ctypes.create_string_buffer(wanted.encode() or suited(cpu_flags()))
    _kept.append(name)
    _words(device)[_CPU_WORD] = ctypes.addressof(name)


def cpu(device: Any) -> str:
    """Return the CPU's name for which the wheel's PoCL compiles; "" for other drivers."""
    return _at(device, _CPU_WORD).decode() if device.platform.version == REPAIRED else ""


def wide(device: Any) -> bool:
    """Return whether a device of a CPU computes with sixteen floats at once, if built for it.

    Parameters
    ----------
    device : pyopencl.Device
    """
    without = [name for name, needed in _NAMES if not needed >= AVX512]
    return cpu_flags() >= AVX512 and cpu(device).encode() not in without


def suited(flags: set[str]) -> bytes:
    """Return the CPU's name, as LLVM 14 has it, that suits the flags of /proc/cpuinfo."""
    return next(name for name, needed in _NAMES if needed <= flags)


def _words(device: Any) -> Any:
    return (ctypes.c_void_p * (_CPU_WORD + 1)).from_address(device.int_ptr)


def _at(device: Any, word: int) -> bytes:
    pointer = _words(device)[word]
    return ctypes.string_at(pointer) if pointer else b""
