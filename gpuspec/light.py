"""From a part to a light map and its images, on any device.

`light_map` and `backend` say what every backend gives; `opencl`, `opengl`, `vulkan` and
`float64_backend` are the backends, `devices` the one file that names them all. `opencl_device` is
what OpenCL has and a light map has not: devices, programs, buffers, launches. `records` and
`sources` are what programs on a device are given, `levels` how many designs at once are counted.
Imports `part`, `station` and what stands below them; nothing of detection.
"""
