/* Many designs at once: how often each level of the closed-form aspect image comes. The images are
   never stored; a design's pixels leave as 256 counts. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"

/* Level of a grey level: of the 256 thresholds, 1 / `per_dn` apart from 0 on, how many it is above.
   With 8 bits per pixel they are the whole grey levels, `per_dn` is 1. A level is the place of a
   counter: what rounding puts above the last is the last, and what is no number is 0. */
DEVICE REAL level_of(REAL grey, float per_dn) {
    REAL level = -floor(-per_dn * grey);
    REAL none = 0.0f, last = LEVELS - 1.0f;
    level = (level > 0.0f ? level : none);
    return level < last ? level : last;
}

/* Level of a pixel of the aspect image under the design d. */
#define LEVEL(at)                                                                              \
    level_of(d.full_scale * mean_over_scan(exposed_ray(d, LOAD(light, at), LOAD(footprint, at),  \
                                                     LOAD(irradiance, at), 1), d.distinct_shifts),  \
             per_dn)

#if WIDTH == 8

/* Levels of some pixels under many designs. One work-item does a stretch of pixels for one design;
   designs are the fast index, so that a stretch stays in the cache for all of them. Each lane
   counts for itself: an even surface wants one counter only, and would wait for it. */
__kernel void count_levels(__global uint *counts, __global const float *light,
                           __global const float *footprint, __global const float *irradiance,
                           __global const Design *designs, float per_dn, uint pixels,
                           uint stretch) {
    Design d = designs[get_global_id(0)];
    uint first = (uint)get_global_id(1) * stretch;
    uint last = first + stretch < pixels ? first + stretch : pixels;
    uint own[8 * LEVELS];
    for (int i = 0; i < 8 * LEVELS; i++) {
        own[i] = 0u;
    }
    for (uint at = first; at < last; at += 8u) {
        int8 level = convert_int8(LEVEL(at));
        own[level.s0]++;
        own[LEVELS + level.s1]++;
        own[2 * LEVELS + level.s2]++;
        own[3 * LEVELS + level.s3]++;
        own[4 * LEVELS + level.s4]++;
        own[5 * LEVELS + level.s5]++;
        own[6 * LEVELS + level.s6]++;
        own[7 * LEVELS + level.s7]++;
    }
    for (int i = 0; i < LEVELS; i++) {
        uint sum = 0u;
        for (int lane = 0; lane < 8; lane++) {
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

/* Levels of some pixels under many designs. One work-group does a stretch of pixels for one design;
   designs are the fast index, so that a stretch stays in the cache for all of them. Neighbours
   count in different copies: an even surface wants one counter only, and would wait for it. */
__kernel void count_levels(__global uint *counts, __global const float *light,
                           __global const float *footprint, __global const float *irradiance,
                           __global const Design *designs, float per_dn, uint pixels,
                           uint stretch) {
    __local uint own[COPIES * APART];
    uint item = (uint)get_local_id(1), items = (uint)get_local_size(1);
    for (uint i = item; i < COPIES * APART; i += items) {
        own[i] = 0u;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    Design d = designs[get_group_id(0)];
    uint first = (uint)(get_global_id(1) / items) * stretch;
    uint last = first + stretch < pixels ? first + stretch : pixels;
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
__kernel void zone_peaks(__global float *peaks, __global const float *light,
                         __global const float *footprint, __global const float *irradiance,
                         __global const Design *designs, float per_dn, __global const uint *first) {
    Design d = designs[get_global_id(0)];
    REAL peak = 0.0f;
    for (uint at = first[get_global_id(1)]; at < first[get_global_id(1) + 1]; at += WIDTH) {
        peak = max(peak, LEVEL(at));
    }
    size_t zone = get_global_id(1) - get_global_offset(1);
    STORE(peak, peaks, (get_global_id(0) * get_global_size(1) + zone) * WIDTH);
}

/* A grey level, in thresholds, that no pixel of a region is above under a design, whatever its light
   coordinate: of the region's widest footprint, and of an irradiance that makes up for the rest. */
__kernel void ceilings(__global float *highest, __global const float *footprint,
                       __global const float *irradiance, __global const Design *designs,
                       float per_dn) {
    Design d = designs[get_global_id(0)];
    size_t at = get_global_id(1) * WIDTH;
    Trapezoid t = exposed_ray(d, 0.0f, LOAD(footprint, at), LOAD(irradiance, at), 1);
    size_t begin = get_global_offset(1) * WIDTH;
    STORE(per_dn * (d.full_scale * highest_mean_over_scan(t, d.distinct_shifts)), highest,
          get_global_id(0) * get_global_size(1) * WIDTH + at - begin);
}

/* Puts chosen pixels of some rows of a light map side by side; those of other rows stay as they
   are, with `begin` without light. */
__kernel void gather_pixels(__global float *light, __global float *footprint,
                            __global float *irradiance, __global const float *of_light,
                            __global const float *of_footprint,
                            __global const float *of_irradiance, __global const uint *chosen,
                            int begin) {
    size_t i = get_global_id(0);
    uint at = chosen[i];
    if (at != NO_PIXEL) {
        light[i] = of_light[at];
        footprint[i] = of_footprint[at];
        irradiance[i] = of_irradiance[at];
    } else if (begin) {
        light[i] = 0.0f;
        footprint[i] = 1.0f;
        irradiance[i] = 0.0f;
    }
}
