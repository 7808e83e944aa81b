/* Images of the sequence on demand, and what it is fused to, image by image. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"

/* Images whose exposure is worked out together: each sub-ray's trapezoid is made once for all. */
#define CHUNK 8

/* The light map of a tile and where this work-item stands in it. */
typedef struct {
    __global const float *light;
    __global const float *footprint;
    __global const float *irradiance;
    size_t at;
    size_t plane;
    int sub_rays;
} Pixels;

/* Exposure of sub-ray i as a function of the shift. */
DEVICE Trapezoid exposed_at(Pixels px, Design d, int i) {
    size_t at = px.at + i * px.plane;
    return exposed_ray(d, LOAD(px.light, at), LOAD(px.footprint, at), LOAD(px.irradiance, at),
                       px.sub_rays);
}

/* Exposure E of CHUNK images from image `first` on, summed over sub-rays. */
DEVICE void exposures(Pixels px, Design d, int first, REAL signal[CHUNK]) {
    for (int j = 0; j < CHUNK; j++) {
        signal[j] = 0.0f;
    }
    for (int i = 0; i < px.sub_rays; i++) {
        Trapezoid t = exposed_at(px, d, i);
        for (int j = 0; j < CHUNK; j++) {
            signal[j] += at_shift(t, shift_of(d, first + j));
        }
    }
}

#define PIXELS(px, column, row)                                                               \
    Pixels px;                                                                                \
    size_t stride = get_global_size(0) * WIDTH;                                               \
    px.light = light;                                                                         \
    px.footprint = footprint;                                                                 \
    px.irradiance = irradiance;                                                               \
    px.sub_rays = sub_rays;                                                                   \
    px.plane = stride * (size_t)rows;                                                         \
    px.at = get_global_id(1) * stride + get_global_id(0) * WIDTH;                             \
    Design d = *design;                                                                       \
    COUNTER column = TO_COUNTER((float)(get_global_id(0) * WIDTH) + LANES);                   \
    COUNTER row = (uint)(first_row + get_global_id(1));                                       \
    Normals pattern = fixed_pattern(d, column, row);

/* Image k of the sequence, in grey levels. */
__kernel void image_at(__global float *grey, __global const float *light,
                       __global const float *footprint, __global const float *irradiance,
                       __constant Design *design, int sub_rays, int first_row, int rows, int k) {
    PIXELS(px, column, row)
    REAL signal = 0.0f;
    for (int i = 0; i < sub_rays; i++) {
        signal += at_shift(exposed_at(px, d, i), shift_of(d, k));
    }
    STORE(grey_level(signal, d, k, column, row, pattern), grey, px.at);
}

/* Mean of all images, without holding any. */
__kernel void mean_of_images(__global float *mean, __global const float *light,
                             __global const float *footprint, __global const float *irradiance,
                             __constant Design *design, int sub_rays, int first_row, int rows) {
    PIXELS(px, column, row)
    int images = (int)d.images;
    REAL sum = 0.0f;
    for (int first = 0; first < images; first += CHUNK) {
        REAL signal[CHUNK];
        exposures(px, d, first, signal);
        REAL part = 0.0f;
        for (int j = 0; j < CHUNK; j++) {
            if (first + j < images) {
                part += grey_level(signal[j], d, first + j, column, row, pattern);
            }
        }
        sum += part;
    }
    STORE(sum / (float)images, mean, px.at);
}

/* Mean, maximum, minimum, standard deviation and mean |y(k + m) - y(k)| in one pass, one plane
   each. The differential pairs wrap around where the shifts fill the period; else the last
   m images begin no pair. Deviation by Welford's update, which does not cancel. */
__kernel void fuse_images(__global float *fused, __global const float *light,
                          __global const float *footprint, __global const float *irradiance,
                          __constant Design *design, int sub_rays, int first_row, int rows) {
    PIXELS(px, column, row)
    int images = (int)d.images, lag = (int)d.lag, pairs = (int)d.pairs;
    REAL mean = 0.0f, spread = mean, difference = mean;
    REAL high = mean, low = mean + d.full_scale;
    for (int first = 0; first < images; first += CHUNK) {
        REAL signal[CHUNK], later[CHUNK];
        exposures(px, d, first, signal);
        exposures(px, d, first + lag, later);
        for (int j = 0; j < CHUNK; j++) {
            int k = first + j;
            if (k < images) {
                REAL y = grey_level(signal[j], d, k, column, row, pattern);
                REAL gap = y - mean;
                mean += gap / (float)(k + 1);
                spread += gap * (y - mean);
                high = max(high, y);
                low = min(low, y);
                if (k < pairs) {
                    int partner = (k + lag) % images;
                    difference += fabs(grey_level(later[j], d, partner, column, row, pattern) - y);
                }
            }
        }
    }
    STORE(mean, fused, px.at);
    STORE(high, fused, px.at + px.plane);
    STORE(low, fused, px.at + 2 * px.plane);
    STORE(sqrt(max(spread / (float)images, 0.0f)), fused, px.at + 3 * px.plane);
    STORE(difference / (float)(pairs > 0 ? pairs : 1), fused, px.at + 4 * px.plane);
}
