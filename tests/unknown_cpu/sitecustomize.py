"""On any machine, PoCL as pip installs it reports a CPU that its compiler does not know.

Python runs this file at its start where this folder is on PYTHONPATH.
"""

import contextlib
import ctypes

NAME = ctypes.create_string_buffer(b"generic")  # for as long as the process lives

with contextlib.suppress(ImportError):  # pip's own processes, before anything is installed
    import pyopencl as cl

    from gpuspec.light import pocl

    for platform in cl.get_platforms():
        if platform.version == pocl.REPAIRED:
            for device in platform.get_devices():
                pocl._words(device)[pocl._CPU_WORD] = ctypes.addressof(NAME)
