/* Images of the sequence on demand, and what it is fused to, image by image. A launch makes some
   rows of a tile, and its grey levels begin with the first of them. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"

/* The light map of a tile and where this work-item stands in it. */
typedef struct {
    __global const float *light;
    __global const float *footprint;
    __global const float *irradiance;
    size_t at;
    size_t plane;
    int sub_rays;
} Pixels;

DEVICE Ray ray_at(Pixels px, int i) {
    size_t at = px.at + i * px.plane;
    Ray ray = {LOAD(px.light, at), LOAD(px.footprint, at), LOAD(px.irradiance, at)};
    return ray;
}

#define RAY(px, i) ray_at(px, i)
#include "scan.h"

/* What a work-item starts from: its pixels, and where in the launch's grey levels they stand. */
#define PIXELS(px, column, row)                                                               \
    size_t stride = get_global_size(0) * WIDTH;                                               \
    size_t at = get_global_id(1) * stride + get_global_id(0) * WIDTH;                         \
    Pixels px = {light, footprint, irradiance, at, stride * (size_t)rows, sub_rays};          \
    size_t out = at - get_global_offset(1) * stride;                                          \
    Design d = *design;                                                                       \
    COUNTER column = TO_COUNTER((float)(get_global_id(0) * WIDTH) + LANES);                   \
    COUNTER row = (uint)(first_row + get_global_id(1));

/* Image k of the sequence, in grey levels. */
__kernel void image_at(__global float *grey, __global const float *light,
                       __global const float *footprint, __global const float *irradiance,
                       __global const Design *restrict design, int sub_rays, int first_row,
                       int rows, int k) {
    PIXELS(px, column, row)
    Normals pattern = fixed_pattern(d, column, row);
    STORE(grey_level(signal_of(d, px, k), d, k, column, row, pattern), grey, out);
}

/* Mean of all images, without holding any. */
__kernel void mean_of_images(__global float *mean, __global const float *light,
                             __global const float *footprint, __global const float *irradiance,
                             __global const Design *restrict design, int sub_rays, int first_row,
                             int rows) {
    PIXELS(px, column, row)
    STORE(mean_over_images(d, px, column, row), mean, out);
}

/* Mean, maximum, minimum, standard deviation and differential, one plane each.
   Without restrict: with it PoCL spills the loop's registers, and takes 1.5 times as long. */
__kernel void fuse_images(__global float *fused, __global const float *light,
                          __global const float *footprint, __global const float *irradiance,
                          __global const Design *design, int sub_rays, int first_row,
                          int rows) {
    PIXELS(px, column, row)
    size_t plane = stride * get_global_size(1);
    Fusion f = fusion_over_images(d, px, column, row);
    STORE(f.mean, fused, out);
    STORE(f.high, fused, out + plane);
    STORE(f.low, fused, out + 2 * plane);
    STORE(f.deviation, fused, out + 3 * plane);
    STORE(f.difference, fused, out + 4 * plane);
}
