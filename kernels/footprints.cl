/* Pixels of many sub-rays: what they see of the light is added up once, for every design. With F(l) the
   share of a pixel's footprint before the light coordinate l, its lit fraction is the sum of 1 - F at
   the edges where the light begins, less that where it ends, whatever the stripes are: F stands in a
   table, its values and slopes at equal steps, a cubic between two of them. An edge is looked up only
   where it cuts the footprint. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"
#include "level.h"

/* The table of a sensor's noise. */
typedef struct {
    __global const float *entries;
    float last;
} Cells;

#define CELL(cells, i) four_at((cells).entries, TO_COUNTER(4.0f * (i)))
#include "noise.h"

/* Nodes of a pixel that are worked out together. */
#define NODES 16
#define NODE_NUMBERS ((float16)(0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f, 8.0f, 9.0f, 10.0f, 11.0f, 12.0f, 13.0f, 14.0f, 15.0f))
typedef float16 Nodes __attribute__((aligned(4)));

/* What a sub-ray sees of the light, in steps of the table: a trapezoid. */
typedef struct {
    REAL foot;
    REAL flank;
    REAL corner;
    REAL bend; /* 1/2 corner */
    REAL weight; /* share of the pixel's irradiance over the flank */
} Kernels;

/* Images of a pixel that are added up together. */
#define IMAGES 64

/* Where the footprint of each of WIDTH pixels begins, how long the steps of its table are, in mm, how many, and
   the irradiance of all its sub-rays. The cubic is off, in shares of the whole, by the step squared
   times the curvatures 1/w1 w2 of the sub-rays' kernels, which add up by their squares. */
__kernel void measure_footprints(__global float *begin, __global float *step,
                                 __global float *steps, __global float *whole, LIGHT_MAP(const),
                                 int sub_rays, uint own, float bound) {
    size_t plane = get_global_size(0) * WIDTH;
    size_t at = get_global_id(0) * WIDTH;
    REAL none = 0.0f;
    REAL first = 1e30f;
    REAL last = -1e30f;
    REAL sum = 0.0f;
    REAL squares = 0.0f;
    for (int i = 0; i < sub_rays; i++) {
        Ray ray = RAY_AT(at + i * plane);
        MASK seen = ray.irradiance > 0.0f;
        REAL reach = 0.5f * (ray.wide + ray.narrow);
        first = (seen ? min(first, ray.light - reach) : first);
        last = (seen ? max(last, ray.light + reach) : last);
        REAL own = (seen ? ray.irradiance : none);
        REAL bent = own / (ray.wide * max(ray.narrow, ray.wide * (1.0f / 16.0f)));
        sum += own;
        squares += bent * bent;
    }
    MASK lit = sum > 0.0f;
    REAL share = max(sum, 1e-30f);
    REAL length = (lit ? last - first : none);
    REAL count = max(-floor(-length * sqrt(sqrt(squares) / (share * bound))), none + 1.0f);
    STORE((lit ? first : none), begin, own + at);
    STORE((lit ? length / count : none + 1.0f), step, own + at);
    STORE((lit ? count : none + 1.0f), steps, own + at);
    STORE(sum / (float)sub_rays, whole, own + at);
}

/* The tables of WIDTH pixels: values and slopes at their nodes, those of pixel i from first[i] up to
   first[i + 1]. A sub-ray adds what its trapezoid rises by from node to node, so that sums over nodes are F. */
__kernel void lay_footprints(__global float2 *nodes, LIGHT_MAP(const), __global const uint *first,
                             __global const float *begin, __global const float *step,
                             __global const float *whole, int sub_rays, uint own) {
    size_t plane = get_global_size(0) * WIDTH;
    size_t at = get_global_id(0) * WIDTH;
    Kernels kernels[SUB_RAYS];
    REAL per_mm = 1.0f / LOAD(step, own + at);
    REAL share = 1.0f / max(LOAD(whole, own + at) * (float)sub_rays, 1e-30f);
    for (int i = 0; i < sub_rays; i++) {
        Ray ray = RAY_AT(at + i * plane);
        REAL flank = ray.wide * per_mm;
        REAL corner = max(ray.narrow * per_mm, 1e-3f);
        REAL inverse = 1.0f / (flank * corner);
        kernels[i].foot = (ray.light - LOAD(begin, own + at)) * per_mm - 0.5f * (flank + corner);
        kernels[i].flank = flank;
        kernels[i].corner = corner;
        kernels[i].bend = 0.5f * flank * inverse;
        kernels[i].weight = ray.irradiance * share * (corner * inverse);
    }
    for (int lane = 0; lane < WIDTH; lane++) {
        uint from = first[own + at + lane];
        int count = (int)(first[own + at + lane + 1] - from);
        float rise[TABLE_STEPS + 1 + NODES];
        float slope[TABLE_STEPS + 1 + NODES];
        for (int k = 0; k < count; k += NODES) {
            *(Nodes *)(rise + k) = 0.0f;
            *(Nodes *)(slope + k) = 0.0f;
        }
        for (int i = 0; i < sub_rays && count > 0; i++) {
            float weight = LANE(kernels[i].weight, lane);
            float foot = LANE(kernels[i].foot, lane);
            float flank = LANE(kernels[i].flank, lane);
            float corner = LANE(kernels[i].corner, lane);
            float bend = LANE(kernels[i].bend, lane);
            int k = foot > 0.0f ? (int)foot + 1 : 0;
            float before = 0.0f;
            for (; weight > 0.0f && before < flank && k < count; k += NODES) {
                float16 up = (float)k + NODE_NUMBERS - foot;
                up = up > 0.0f ? up : 0.0f;
                up = up < flank + corner ? up : flank + corner;
                float16 toe = up < corner ? up : corner;
                float16 shoulder = up > flank ? up - flank : 0.0f;
                float16 risen = (up - toe) + (toe * toe - shoulder * shoulder) * bend;
                risen = up < flank + corner ? risen : flank;
                float16 last = (float16)(before, risen.s012, risen.s3456, risen.s789a, risen.sbcd, risen.se);
                before = risen.sf;
                *(Nodes *)(rise + k) += weight * (risen - last);
                *(Nodes *)(slope + k) += (2.0f * bend * weight) * (toe - shoulder);
            }
        }
        float sum = 0.0f;
        for (int k = 0; k < count; k++) {
            sum += rise[k];
            nodes[from + k] = (float2)(sum, slope[k]);
        }
    }
}

/* Edges of the stripes before WIDTH footprints: number n stands at x + n `between`, in steps of their
   tables, in image number n + `image` of a period. */
typedef struct {
    REAL x;
    REAL between;
    REAL steps;
    COUNTER first; /* nodes */
} Edges;

/* Adds to the images from `c` up to `end` of a period's `images` what of the footprints lies beyond the
   edges. */
DEVICE void add_edges(REAL *lit, int c, int end, int images, Edges edges, int image,
                      __global const float *nodes, float sign) {
    REAL last = edges.steps - 1.0f;
    int count = (int)-LEAST(floor((edges.x - edges.steps) / edges.between));
    for (int turn = c - image; turn < count; turn += images) {
        int to = turn + end - c < count ? turn + end - c : count;
        for (int n = turn > 0 ? turn : 0; n < to; n++) {
            REAL place = clamp(edges.x + edges.between * (float)n, 0.0f, edges.steps);
            REAL k = floor(min(place, last));
            REAL t = place - k;
            Four pair = four_at(nodes, 2u * (edges.first + TO_COUNTER(k)));
            REAL value = pair.a, slope = pair.b;
            REAL rise = pair.c - value;
            REAL cubic = (slope + pair.d) - 2.0f * rise;
            value += t * (slope + t * ((rise - slope - cubic) + t * cubic));
            value = (place < edges.steps ? value : 1.0f + 0.0f * value);
            lit[n - turn] += sign - sign * value;
        }
    }
}

/* Grey levels of WIDTH pixels under designs that differ in exposure alone, added up over a period's
   images: without noise E up to 1; else means and variances. */
typedef struct {
    REAL mean[EXPOSURES];
    REAL variance[EXPOSURES];
} Sums;

DEVICE void add_images(Sums *sums, Design d, REAL *seen, int images,
                       __global const float *exposures, int count) {
    for (int n = images; n % 4 != 0; n++) {
        seen[n] = 0.0f;
    }
    for (int e = 0; e < count; e++) {
        float gain = exposures[e];
        REAL sum = 0.0f;
        for (int n = 0; n < images; n += 4) { /* one sum of all would wait for each */
            sum += (min(gain * seen[n], 1.0f) + min(gain * seen[n + 1], 1.0f))
                   + (min(gain * seen[n + 2], 1.0f) + min(gain * seen[n + 3], 1.0f));
        }
        sums->mean[e] += sum;
    }
}

DEVICE void add_noisy_images(Sums *sums, Design d, REAL *seen, int images,
                             __global const float *exposures, int count, Normals pattern,
                             Cells cells) {
    float dn = d.full_scale - d.black_level;
    float shot = 1.0f / d.saturation;
    float read = d.read_noise * d.read_noise * shot * shot;
    REAL none = 0.0f;
    REAL own = max(1.0f + d.prnu * pattern.first, 0.0f);
    REAL dark = max(d.dark_signal + d.dsnu * pattern.second, 0.0f) * shot;
    for (int e = 0; e < count; e++) {
        REAL gain = own * exposures[e];
        for (int n = 0; n < images; n++) {
            REAL signal = gain * seen[n] + dark;
            Excess excess = cell_excess(cells, place_of(signal));
            REAL even = dn * dn * (shot * signal + read) + 1.0f / 12.0f;
            sums->mean[e] += dn * min(signal, 1.0f) + excess.mean;
            sums->variance[e] += (signal < 1.0f ? even : none) + excess.variance;
        }
    }
}

/* What WIDTH pixels are looked up by; `number` is their place in an image of so many columns. */
#define TABLES                                                                                \
    __global const float *nodes, __global const uint *first, __global const uint *of,             \
        __global const uint *number, uint columns, __global const float *begin,                  \
        __global const float *step, __global const float *steps, __global const float *whole,    \
        __global const float *entries, float last, __global const Design *restrict design,       \
        __global const float *restrict exposures, int count
#define LOOKED_UP                                                                             \
    nodes, first, of, number, columns, begin, step, steps, whole, entries, last, design,           \
        exposures, count

DEVICE Sums sums_of_images(TABLES) {
    Design d = *design;
    Cells cells = {entries, last};
    size_t at = get_global_id(0) * WIDTH;
    COUNTER pixel = LOAD_COUNTERS(of, at);
    COUNTER row = LOAD_COUNTERS(number, at) / columns;
    Normals pattern = fixed_pattern(d, LOAD_COUNTERS(number, at) - row * columns, row);
    int images = (int)d.distinct_shifts;
    /* Where light begins edge i = n + K m is that of image n, at n / K + m. From image to image it moves by
       `between` steps of the table; the footprint begins at `start` images. Numbered from the first edge that
       cuts it, images are others for every pixel, and their mean is the same. Where light ends edges are
       fewer than `lead` images ahead, and those before the footprint are lit. */
    REAL per_mm = d.periods_per_mm * d.distinct_shifts;
    REAL start = GATHER(begin, pixel) * per_mm;
    REAL ahead = -floor(-start) - start;
    float luminous = d.luminous_share * d.distinct_shifts;
    int lead = (int)luminous + 1;
    Edges edges;
    edges.between = 1.0f / (GATHER(step, pixel) * per_mm);
    edges.steps = GATHER(steps, pixel);
    edges.first = LOAD_COUNTERS(first, at);
    edges.x = ahead * edges.between;
    Edges ends = edges;
    ends.x = (ahead + (luminous - (float)lead)) * edges.between;
    REAL full = GATHER(whole, pixel);
    REAL dark = full * (d.dark_leak + d.diffuse);
    REAL bright = full * (1.0f - d.dark_leak);
    Sums sums;
    for (int e = 0; e < count; e++) {
        sums.mean[e] = 0.0f;
        sums.variance[e] = 0.0f;
    }
    for (int c = 0; c < images; c += IMAGES) {
        int end = c + IMAGES < images ? c + IMAGES : images;
        REAL seen[IMAGES];
        for (int n = c; n < end; n++) {
            seen[n - c] = n < images - lead ? 0.0f : 1.0f;
        }
        add_edges(seen, c, end, images, edges, 0, nodes, 1.0f);
        add_edges(seen, c, end, images, ends, images - lead, nodes, -1.0f);
        for (int n = 0; n < end - c; n++) {
            seen[n] = dark + bright * seen[n];
        }
        if (d.noise == 0.0f) {
            add_images(&sums, d, seen, end - c, exposures, count);
        } else {
            add_noisy_images(&sums, d, seen, end - c, exposures, count, pattern, cells);
        }
    }
    return sums;
}

DEVICE Moments moments_of(Sums *sums, Design d, int e) {
    Moments m;
    m.mean = d.black_level + sums->mean[e] / d.distinct_shifts;
    m.variance = max(sums->variance[e], 0.0f) / (d.distinct_shifts * d.images);
    return m;
}

/* The aspect image or, with noise, one draw of it, see `one_draw`. */
DEVICE REAL grey_of(Sums *sums, Design d, int e, __global const uint *number, uint columns) {
    if (d.noise == 0.0f) {
        return d.full_scale * sums->mean[e] / d.distinct_shifts;
    }
    COUNTER own = LOAD_COUNTERS(number, get_global_id(0) * WIDTH);
    COUNTER row = own / columns;
    REAL normal = normal_of(d, own - row * columns, row);
    return one_draw(moments_of(sums, d, e), normal, d.full_scale);
}

/* Stores a value of each of a work-item's pixels at its place in a plane. */
DEVICE void scatter(REAL value, __global float *plane, __global const uint *to) {
    for (int lane = 0; lane < WIDTH; lane++) {
        plane[to[get_global_id(0) * WIDTH + lane]] = LANE(value, lane);
    }
}

/* Aspect images over whole periods in equal steps, a plane of `plane` pixels for each exposure. */
__kernel void means_of_footprints(__global float *means, TABLES, __global const uint *to,
                                  uint plane) {
    Sums sums = sums_of_images(LOOKED_UP);
    for (int e = 0; e < count; e++) {
        scatter(grey_of(&sums, *design, e, number, columns), means + e * (size_t)plane, to);
    }
}

/* Mean and standard deviation of such a one with noise over all its draws, a plane each. */
__kernel void moments_of_footprints(__global float *planes, TABLES, __global const uint *to,
                                    uint plane) {
    Sums sums = sums_of_images(LOOKED_UP);
    Moments m = moments_of(&sums, *design, 0);
    scatter(m.mean, planes, to);
    scatter(sqrt(m.variance), planes + plane, to);
}

/* Levels of aspect images; pixels with no place are left out. */
__kernel void levels_of_footprints(__global uchar *levels, TABLES, __global const uint *to,
                                   uint plane, float per_dn) {
    Sums sums = sums_of_images(LOOKED_UP);
    for (int e = 0; e < count; e++) {
        REAL level = level_of(grey_of(&sums, *design, e, number, columns), per_dn);
        for (int lane = 0; lane < WIDTH; lane++) {
            uint place = to[get_global_id(0) * WIDTH + lane];
            if (place != NO_PIXEL) {
                levels[e * (size_t)plane + place] = (uchar)LANE(level, lane);
            }
        }
    }
}

/* How often each level comes in sets of the same kind, and the highest of each set, exposure by exposure, the
   first of which is that of a design. The pixels of set i are those from first[i] to first[i + 1]. */
__kernel void count_footprints(__global uint *counts, __global uint *highest,
                               __global const uchar *levels, __global const uint *first,
                               __global const uint *kinds, uint plane, uint design) {
    size_t e = get_global_id(0), set = get_global_id(1);
    uint own[LEVELS];
    for (int i = 0; i < LEVELS; i++) {
        own[i] = 0u;
    }
    __global const uchar *level = levels + e * plane;
    for (uint at = first[set]; at < first[set + 1]; at++) {
        own[level[at]]++;
    }
    uint peak = 0u;
    for (uint i = 0; i < LEVELS; i++) {
        if (own[i] > 0u) {
            atomic_add(counts + ((design + e) * KINDS + kinds[set]) * LEVELS + i, own[i]);
            peak = i;
        }
    }
    highest[(design + e) * get_global_size(1) + set] = peak;
}
