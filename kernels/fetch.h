/* Where OpenCL's programs have what `scan.h` and `noise.h` fetch. */
#ifndef FETCH_H
#define FETCH_H

#ifndef GPUSPEC_GLSL

#include "light_map.h"

/* The light map of a tile, and where a work-item stands in it. */
typedef struct {
    __global const float *light;
    __global const float *wide;
    __global const float *narrow;
    __global const float *irradiance;
    size_t at;
    size_t plane;
    int sub_rays;
} Pixels;

#define RAY(px, i)                                                                            \
    ray_of((px).light, (px).wide, (px).narrow, (px).irradiance, (px).at + (i) * (px).plane)

/* The table of a sensor's noise. */
typedef struct {
    __global const float *entries;
    float last;
} Cells;

#define CELL(cells, i) four_at((cells).entries, TO_COUNTER(4.0f * (i)))

#endif

#endif
