/* Many designs at once: how often each level of the closed-form aspect image comes. The images are
   never stored; a design's pixels leave as 256 counts. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"
#include "level.h"
#include "fetch.h"
#include "noise.h"

/* The normal number of what is no pixel: it has level 0 under every design. */
#define NOT_DRAWN -1e30f

/* Of pixels with noise: their normal numbers, for a draw, their gain and their dark signal. */
#define NOISE(access)                                                                         \
    __global access float *normal, __global access float *gain, __global access float *dark,   \
        __global const float *entries, float last_cell

/* What makes a grey level from a pixel under a design, the same for all pixels. */
#define UNDER(design)                                                                         \
    Design d = design;                                                                        \
    Cells cells = {entries, last_cell};                                                       \
    Noise noise = noise_of(d, cells);

/* Grey level of a pixel of the aspect image or, with noise, of one draw of it. */
#define GREY(at) grey_of(d, noise, cells, RAY_AT(at), normal, gain, dark, at)

DEVICE REAL grey_of(Design d, Noise noise, Cells cells, Ray ray, __global const float *normal,
                    __global const float *gain, __global const float *dark, size_t at) {
    Trapezoid t = exposed_ray(d, ray, 1);
    if (d.noise == 0.0f) {
        return d.full_scale * mean_over_scan(t, d.distinct_shifts);
    }
    if (HAS_PATTERN(d)) {
        Normals pattern = {LOAD(gain, at), LOAD(dark, at)};
        t = sensed(t, pattern, d);
    } else {
        t = sensed_alike(t, d);
    }
    Moments m = noisy_mean_over_scan(t, d, noise, cells);
    REAL drawn = LOAD(normal, at);
    REAL nothing = 0.0f;
    return drawn == NOT_DRAWN ? nothing : one_draw(m, drawn, d.full_scale);
}

/* Its level. */
#define LEVEL(at) level_of(GREY(at), per_dn)

#if WIDTH > 1

/* Levels of the `pixels` from place `begin` on under many designs. One work-item does a stretch of
   pixels for one design;
   designs are the fast index, so that a stretch stays in the cache for all of them. Each lane
   counts for itself: an even surface wants one counter only, and would wait for it. */
__kernel void count_levels(__global uint *counts, LIGHT_MAP(const), NOISE(const),
                           __global const Design *designs, float per_dn, uint begin,
                           uint pixels, uint stretch) {
    UNDER(designs[get_global_id(0)])
    uint first = begin + (uint)get_global_id(1) * stretch;
    uint end = begin + pixels;
    uint last = first + stretch < end ? first + stretch : end;
    uint own[WIDTH * LEVELS];
    for (int i = 0; i < WIDTH * LEVELS; i++) {
        own[i] = 0u;
    }
    for (uint at = first; at < last; at += WIDTH) {
        union {
            MASK of;
            int lane[WIDTH];
        } level;
        level.of = WIDE(convert_int, WIDTH)(LEVEL(at));
#pragma unroll
        for (int i = 0; i < WIDTH; i++) {
            own[i * LEVELS + level.lane[i]]++;
        }
    }
    for (int i = 0; i < LEVELS; i++) {
        uint sum = 0u;
        for (int lane = 0; lane < WIDTH; lane++) {
            sum += own[lane * LEVELS + i];
        }
        if (sum > 0u) {
            atomic_add(counts + get_global_id(0) * LEVELS + i, sum);
        }
    }
}

#else

/* Counters of a work-group, in as many copies as the device's local memory holds, each begun in
   another bank of it. A little is left to the compiler. */
#define APART (LEVELS + 1)
#define FITTING ((LOCAL_BYTES - 512) / (4 * APART))
#define COPIES (FITTING < 16 ? FITTING : 16)

/* Levels of the `pixels` from place `begin` on under many designs. One work-group does a stretch of
   pixels for one design;
   designs are the fast index, so that a stretch stays in the cache for all of them. Neighbours
   count in different copies: an even surface wants one counter only, and would wait for it. */
__kernel void count_levels(__global uint *counts, LIGHT_MAP(const), NOISE(const),
                           __global const Design *designs, float per_dn, uint begin,
                           uint pixels, uint stretch) {
    __local uint own[COPIES * APART];
    uint item = (uint)get_local_id(1), items = (uint)get_local_size(1);
    for (uint i = item; i < COPIES * APART; i += items) {
        own[i] = 0u;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    UNDER(designs[get_group_id(0)])
    uint first = begin + (uint)(get_global_id(1) / items) * stretch;
    uint end = begin + pixels;
    uint last = first + stretch < end ? first + stretch : end;
    uint copy = item % COPIES * APART;
    for (uint at = first + item; at < last; at += items) {
        atomic_inc(own + copy + (uint)LEVEL(at));
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = item; i < LEVELS; i += items) {
        uint sum = 0u;
        for (uint k = 0; k < COPIES; k++) {
            sum += own[k * APART + i];
        }
        if (sum > 0u) {
            atomic_add(counts + get_group_id(0) * LEVELS + i, sum);
        }
    }
}

#endif

/* Highest level in each zone of a launch under many designs, lane by lane: whether, and up to which
   threshold, its defect is hit. The pixels of zone i are those from first[i] to first[i + 1]. */
__kernel void zone_peaks(__global float *peaks, LIGHT_MAP(const), NOISE(const),
                         __global const Design *designs, float per_dn, __global const uint *first) {
    UNDER(designs[get_global_id(0)])
    REAL peak = 0.0f;
    for (uint at = first[get_global_id(1)]; at < first[get_global_id(1) + 1]; at += WIDTH) {
        peak = max(peak, LEVEL(at));
    }
    size_t zone = get_global_id(1) - get_global_offset(1);
    STORE(peak, peaks, (get_global_id(0) * get_global_size(1) + zone) * WIDTH);
}

/* A grey level, in thresholds, that no pixel of a region is above under a design, whatever its light
   coordinate: of two boxes and an irradiance whose exposure is not below that of any there. */
__kernel void ceilings(__global float *highest, LIGHT_MAP(const), float excess, float variance,
                       __global const Design *designs, float per_dn) {
    Design d = designs[get_global_id(0)];
    size_t at = get_global_id(1) * WIDTH;
    Trapezoid t = exposed_ray(d, RAY_AT(at), 1);
    size_t begin = get_global_offset(1) * WIDTH;
    REAL grey = d.full_scale;
    if (d.noise == 0.0f) {
        grey *= highest_mean_over_scan(t, d.distinct_shifts);
    } else {
        grey = highest_draw(t, d, excess, variance);
    }
    STORE(per_dn * grey, highest,
          get_global_id(0) * get_global_size(1) * WIDTH + at - begin);
}

/* Puts chosen entries of some rows of one plane of a light map side by side; those of other rows stay
   as they are, with `begin` they are `blank`. */
__kernel void gather_pixels(__global float *plane, __global const float *of,
                            __global const uint *chosen, int begin, float blank) {
    size_t i = get_global_id(0);
    uint at = chosen[i];
    if (at != NO_PIXEL) {
        plane[i] = of[at];
    } else if (begin) {
        plane[i] = blank;
    }
}

/* Normal numbers of pixels, by their number in an image of so many columns: for one draw, and with
   `pattern` those of gain and dark signal. What is no pixel is not drawn. */
__kernel void pixel_normals(__global float *normal, __global float *gain, __global float *dark,
                            __global const uint *pixels, uint columns,
                            __global const Design *design, int pattern) {
    Design d = *design;
    size_t at = get_global_id(0) * WIDTH;
    COUNTER pixel = LOAD_COUNTERS(pixels, at);
    COUNTER row = pixel / columns;
    COUNTER column = pixel - row * columns;
    REAL nothing = NOT_DRAWN;
    STORE(pixel == NO_PIXEL ? nothing : normal_of(d, column, row), normal, at);
    if (pattern) {
        Normals own = fixed_pattern(d, column, row);
        STORE(own.first, gain, at);
        STORE(own.second, dark, at);
    }
}
