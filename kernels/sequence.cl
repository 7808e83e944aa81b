/* Images of the sequence on demand, and what it is fused to, image by image. A launch makes some
   rows of a tile, and its grey levels begin with the first of them. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"

#include "fetch.h"
#include "scan.h"
#include "noise.h"

/* What a work-item starts from: its pixels, and where in the launch's grey levels they stand. */
#define PIXELS(px, column, row)                                                               \
    size_t stride = get_global_size(0) * WIDTH;                                               \
    size_t at = get_global_id(1) * stride + get_global_id(0) * WIDTH;                         \
    Pixels px = {light, wide, narrow, irradiance, at, stride * (size_t)rows, sub_rays};          \
    size_t out = at - get_global_offset(1) * stride;                                          \
    Design d = *design;                                                                       \
    COUNTER column = TO_COUNTER((float)(get_global_id(0) * WIDTH) + LANES);                   \
    COUNTER row = (uint)(first_row + get_global_id(1));                                       \
    if (columns > 0u) { /* pixels of a list, of an image of so many columns */                \
        COUNTER number = LOAD_COUNTERS(pixels, at + stride * (size_t)first_row);              \
        row = number / columns;                                                               \
        column = number - row * columns;                                                      \
    }

/* Image k of the sequence, in grey levels. */
__kernel void image_at(__global float *grey, LIGHT_MAP(const),
                       __global const Design *restrict design, __global const uint *pixels,
                       uint columns, int sub_rays, int first_row, int rows, int k) {
    PIXELS(px, column, row)
    Normals pattern = fixed_pattern(d, column, row);
    STORE(grey_level(signal_of(d, px, k), d, k, column, row, pattern), grey, out);
}

/* Mean of all images, without holding any. */
__kernel void mean_of_images(__global float *mean, LIGHT_MAP(const),
                             __global const Design *restrict design, __global const uint *pixels,
                             uint columns, int sub_rays, int first_row, int rows) {
    PIXELS(px, column, row)
    STORE(mean_over_images(d, px, column, row), mean, out);
}

/* Mean, maximum, minimum, standard deviation and differential, one plane each.
   Without restrict: with it PoCL spills the loop's registers, and takes 1.5 times as long. */
__kernel void fuse_images(__global float *fused, LIGHT_MAP(const),
                          __global const Design *design, __global const uint *pixels,
                          uint columns, int sub_rays, int first_row, int rows) {
    PIXELS(px, column, row)
    size_t plane = stride * get_global_size(1);
    Fusion f = fusion_over_images(d, px, column, row);
    STORE(f.mean, fused, out);
    STORE(f.high, fused, out + plane);
    STORE(f.low, fused, out + 2 * plane);
    STORE(f.deviation, fused, out + 3 * plane);
    STORE(f.difference, fused, out + 4 * plane);
}

#ifndef PROFILE
/* Mean and standard deviation of the noisy mean over all its draws, and one draw: a plane each. No
   image is made. */
__kernel void noisy_mean(__global float *planes, LIGHT_MAP(const),
                         __global const Design *restrict design, __global const uint *pixels,
                         uint columns, int sub_rays, int first_row, int rows,
                         __global const float *entries, float last) {
    PIXELS(px, column, row)
    size_t plane = stride * get_global_size(1);
    Cells cells = {entries, last};
    Trapezoid t = sensed(exposed_at(d, px, 0), fixed_pattern(d, column, row), d);
    Moments m = noisy_mean_over_scan(t, d, noise_of(d, cells), cells);
    STORE(m.mean, planes, out);
    STORE(sqrt(m.variance), planes, out + plane);
    STORE(one_draw(m, normal_of(d, column, row), d.full_scale), planes, out + 2 * plane);
}
#endif
