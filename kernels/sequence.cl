/* Images of the sequence on demand, and what it is fused to, image by image. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"

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

/* Exposure E of CHUNK images from `first`, `every` images apart, averaged over sub-rays. */
DEVICE void exposures(Pixels px, Design d, int first, int wrap, REAL signal[CHUNK]) {
    REAL zero = 0.0f * LANES;
    for (int j = 0; j < CHUNK; j++) {
        signal[j] = zero;
    }
    float share = 1.0f / (float)px.sub_rays;
    for (int i = 0; i < px.sub_rays; i++) {
        size_t at = px.at + i * px.plane;
        REAL irradiance = share * LOAD(px.irradiance, at);
        Trapezoid t = trapezoid(LOAD(px.light, at), LOAD(px.footprint, at), d.stripes.x, d.stripes.y);
        for (int j = 0; j < CHUNK; j++) {
            float shift = (float)((first + j) % wrap) * d.sequence.y;
            REAL lit = lit_fraction(t, shift, d.stripes.y);
            signal[j] += exposure(lit, irradiance, d.sensor.x, d.stripes.z);
        }
    }
}

DEVICE COUNTER seed_of(Design d) {
    return TO_COUNTER(0.0f * LANES) + ((uint)d.noise.y + 65536u * (uint)d.noise.z);
}

/* Grey level of a pixel in image k. `column`, `row` count over the whole image, so that
   noise does not depend on tiles. */
DEVICE REAL grey_level(REAL signal, Design d, int k, COUNTER column, COUNTER row, Normals pattern) {
    if (d.noise.x == 0.0f) {
        return saturated(signal, d.sensor.y);
    }
    Words words = random_words(column, row, TO_COUNTER(0.0f * LANES) + (uint)k, seed_of(d));
    return noisy_grey_level(signal, pattern, words, d.sensor, d.dark);
}

/* The fixed pattern of a pixel: its share of PRNU and DSNU. */
DEVICE Normals fixed_pattern(Design d, COUNTER column, COUNTER row) {
    Normals none;
    none.first = 0.0f * LANES;
    none.second = 0.0f * LANES;
    if (d.noise.x == 0.0f || (d.dark.y == 0.0f && d.dark.z == 0.0f)) {
        return none;
    }
    Words words = random_words(column, row, TO_COUNTER(0.0f * LANES) + FIXED_PATTERN, seed_of(d));
    return normal_numbers(words.a, words.b);
}

#define PIXELS(px, column, row)                                                               \
    Pixels px;                                                                                \
    size_t stride = get_global_size(0) * WIDTH;                                               \
    px.light = light;                                                                         \
    px.footprint = footprint;                                                                 \
    px.irradiance = irradiance;                                                               \
    px.sub_rays = sub_rays;                                                                   \
    px.plane = stride * get_global_size(1);                                                   \
    px.at = get_global_id(1) * stride + get_global_id(0) * WIDTH;                             \
    Design d = *design;                                                                       \
    COUNTER column = TO_COUNTER((float)(get_global_id(0) * WIDTH) + LANES);                   \
    COUNTER row = TO_COUNTER(0.0f * LANES) + (uint)(first_row + get_global_id(1));            \
    Normals pattern = fixed_pattern(d, column, row);

/* Image k of the sequence, in grey levels. */
__kernel void image_at(__global float *grey, __global const float *light,
                       __global const float *footprint, __global const float *irradiance,
                       __constant Design *design, int sub_rays, int first_row, int k) {
    PIXELS(px, column, row)
    REAL signal[CHUNK];
    exposures(px, d, k, (int)d.sequence.x, signal);
    STORE(grey_level(signal[0], d, k, column, row, pattern), grey, px.at);
}

/* Mean of all images, without holding any. */
__kernel void mean_of_images(__global float *mean, __global const float *light,
                             __global const float *footprint, __global const float *irradiance,
                             __constant Design *design, int sub_rays, int first_row) {
    PIXELS(px, column, row)
    int images = (int)d.sequence.x;
    REAL sum = 0.0f * LANES;
    for (int first = 0; first < images; first += CHUNK) {
        REAL signal[CHUNK];
        exposures(px, d, first, images, signal);
        REAL part = 0.0f * LANES;
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
                          __constant Design *design, int sub_rays, int first_row) {
    PIXELS(px, column, row)
    int images = (int)d.sequence.x, lag = (int)d.sequence.w, pairs = (int)d.noise.w;
    REAL mean = 0.0f * LANES, spread = mean, difference = mean;
    REAL high = mean, low = mean + d.sensor.y;
    for (int first = 0; first < images; first += CHUNK) {
        REAL signal[CHUNK], later[CHUNK];
        exposures(px, d, first, images, signal);
        exposures(px, d, first + lag, images, later);
        for (int j = 0; j < CHUNK; j++) {
            int k = first + j;
            if (k < images) {
                REAL y = grey_level(signal[j], d, k, column, row, pattern);
                REAL gap = y - mean;
                mean += gap / (float)(k + 1);
                spread += gap * (y - mean);
                high = fmax(high, y);
                low = fmin(low, y);
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
    STORE(sqrt(fmax(spread / (float)images, 0.0f)), fused, px.at + 3 * px.plane);
    STORE(difference / (float)max(pairs, 1), fused, px.at + 4 * px.plane);
}
