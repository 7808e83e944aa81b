/* Pixels of many sub-rays under many designs: in every image of a period what they see is looked up in
   their tables (`footprints.cl`) or, where no table holds it, added up sub-ray by sub-ray. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"
#include "level.h"

#include "fetch.h"
#include "scan.h"
#include "noise.h"

/* Images of a pixel that are added up together, a whole number of CHUNKs: as many as a ulong has bits. */
#define IMAGES 64

/* Tables side by side, and where those of a work-item's pixels are. */
typedef struct {
    __global const float *nodes;
    __global const uint *first;
    __global const uint *of;
    __global const float *begin;
    __global const float *step;
    __global const float *steps;
    __global const float *whole;
} Tables;

/* Edges of the stripes before WIDTH footprints: number n stands at x + n `between`, in steps of their
   tables, in image number n + `image` of a period. */
typedef struct {
    REAL x;
    REAL between;
    REAL steps;
    COUNTER first; /* nodes */
} Edges;

/* Adds to the images from `c` up to `end` of a period's `images` what of the footprints lies beyond the
   edges. Returns which of these they cut, a bit each. */
DEVICE ulong add_edges(REAL *seen, int c, int end, int images, Edges edges, int image,
                       __global const float *nodes, float sign) {
    ulong cut = 0;
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
            seen[n - turn] += sign - sign * value;
            cut |= (ulong)1 << (n - turn);
        }
    }
    return cut;
}

/* Grey levels of WIDTH pixels under designs that differ in exposure alone, added up over a period's
   images: without noise E up to 1; else means and variances. */
typedef struct {
    REAL mean[EXPOSURES];
    REAL variance[EXPOSURES];
    REAL lit;    /* how many images see nothing but light, and are not added up yet, */
    REAL dark;   /* or none */
    REAL normal; /* the number that draws a pixel's noise */
} Sums;

/* Adds an image of exposure E at gain 1, `times`. */
DEVICE void add_image(Sums *sums, REAL exposure, REAL times, __global const float *exposures,
                      int count) {
    for (int e = 0; e < count; e++) {
        sums->mean[e] += times * min(exposures[e] * exposure, 1.0f);
    }
}

/* The same with noise. */
DEVICE void add_noisy_image(Sums *sums, Design d, REAL exposure, REAL times,
                            __global const float *exposures, int count, Response own, Cells cells) {
    Noise noise = noise_of(d, cells);
    REAL dark = own.dark * noise.shot;
    for (int e = 0; e < count; e++) {
        Moments m = moments_at(cells, noise, d, own.gain * exposures[e] * exposure + dark);
        sums->mean[e] += times * m.mean;
        sums->variance[e] += times * m.variance;
    }
}

/* Exposure E at gain 1 in the images from `c` up to `end`, from tables. Where light begins edge i = n + K m is
   that of image n, at n / K + m. From image to image it moves by `between` steps of the table; the footprint
   begins at `start` images. Numbered from the first edge that cuts it, images are others for every pixel,
   and their mean is the same. Where light ends edges are fewer than `lead` images ahead, and those
   before the footprint are lit. Where no edge cuts it, it sees nothing but light or none: such images are
   counted, whatever pixels beside it see. Those that are left stand in front, their number is returned, and
   -1 where a pixel has it counted. */
DEVICE int look_up(REAL *seen, Sums *sums, Design d, Tables tables, int c, int end, int images) {
    size_t at = get_global_id(0) * WIDTH;
    COUNTER pixel = LOAD_COUNTERS(tables.of, at);
    REAL per_mm = d.periods_per_mm * d.distinct_shifts;
    REAL start = GATHER(tables.begin, pixel) * per_mm;
    REAL ahead = -floor(-start) - start;
    float luminous = d.luminous_share * d.distinct_shifts;
    int lead = (int)luminous + 1;
    Edges edges;
    edges.between = 1.0f / (GATHER(tables.step, pixel) * per_mm);
    edges.steps = GATHER(tables.steps, pixel);
    edges.first = LOAD_COUNTERS(tables.first, at);
    edges.x = ahead * edges.between;
    Edges ends = edges;
    ends.x = (ahead + (luminous - (float)lead)) * edges.between;
    for (int n = c; n < end; n++) {
        seen[n - c] = n < images - lead ? 0.0f : 1.0f;
    }
    ulong cut = add_edges(seen, c, end, images, edges, 0, tables.nodes, 1.0f)
                | add_edges(seen, c, end, images, ends, images - lead, tables.nodes, -1.0f);
    REAL full = GATHER(tables.whole, pixel);
    REAL none = 0.0f, one = 1.0f;
    int left = 0;
    for (int n = 0; n < end - c; n++) {
        MASK lit = seen[n] == 1.0f, dark = seen[n] == 0.0f;
        sums->lit += (lit ? one : none);
        sums->dark += (dark ? one : none);
        if (cut >> n & 1) {
            REAL exposure = exposure_of(d, max(seen[n], 0.0f), full, 1);
            seen[left] = (lit || dark ? -one : exposure);
            left++;
        }
    }
    return left;
}

/* The same from sub-rays. */
DEVICE int add_up(REAL *seen, Design d, Pixels px, int c, int end) {
    for (int first = c; first < end; first += CHUNK) {
        Signals signals = signals_from(d, px, first);
        for (int j = 0; j < CHUNK; j++) {
            seen[first - c + j] = signals.value[j];
        }
    }
    return end - c;
}

/* A work-item's pixels, as tables or, with sub-rays, as a light map of `plane` places; `number` is their place
   in an image of so many columns, and `to` the one where they are wanted, NO_PIXEL where they are not. */
#define SEEN                                                                                  \
    __global const float *nodes, __global const uint *first, __global const uint *of,             \
        __global const float *begin, __global const float *step, __global const float *steps,     \
        __global const float *whole, LIGHT_MAP(const), int sub_rays, uint plane,                 \
        __global const uint *number, uint columns, __global const uint *to,                      \
        __global const float *entries, float last, __global const Design *restrict design,       \
        __global const float *restrict exposures, int count
#define AS_GIVEN                                                                              \
    nodes, first, of, begin, step, steps, whole, light, wide, narrow, irradiance, sub_rays, plane,  \
        number, columns, to, entries, last, design, exposures, count

DEVICE Sums sums_of_images(SEEN) {
    Design d = *design;
    d.exposure = 1.0f;
    Cells cells = {entries, last};
    Tables tables = {nodes, first, of, begin, step, steps, whole};
    size_t at = get_global_id(0) * WIDTH;
    Pixels px = {light, wide, narrow, irradiance, at, plane, sub_rays};
    COUNTER row = LOAD_COUNTERS(number, at) / columns;
    COUNTER column = LOAD_COUNTERS(number, at) - row * columns;
    Response own = response_of(fixed_pattern(d, column, row), d);
    int images = (int)d.distinct_shifts;
    Sums sums;
    if (d.noise != 0.0f) {
        sums.normal = normal_of(d, column, row);
    }
    REAL none = 0.0f, one = 1.0f;
    for (int e = 0; e < count; e++) {
        sums.mean[e] = none;
        sums.variance[e] = none;
    }
    sums.lit = none;
    sums.dark = none;
#define ADD(exposure, times)                                                                  \
    if (d.noise == 0.0f) {                                                                        \
        add_image(&sums, exposure, times, exposures, count);                                  \
    } else {                                                                                      \
        add_noisy_image(&sums, d, exposure, times, exposures, count, own, cells);             \
    }
    for (int c = 0; c < images; c += IMAGES) {
        int end = c + IMAGES < images ? c + IMAGES : images;
        REAL seen[IMAGES];
        int left = sub_rays == 0 ? look_up(seen, &sums, d, tables, c, end, images)
                                 : add_up(seen, d, px, c, end);
        for (int n = 0; n < left; n++) {
            ADD(max(seen[n], none), (seen[n] < 0.0f ? none : one))
        }
    }
    if (sub_rays == 0) {
        REAL full = GATHER(whole, LOAD_COUNTERS(of, at));
        ADD(exposure_of(d, one, full, 1), sums.lit)
        ADD(exposure_of(d, none, full, 1), sums.dark)
    }
    return sums;
}

DEVICE Moments moments_of(Sums *sums, Design d, int e) {
    Moments m;
    m.mean = sums->mean[e] / d.distinct_shifts;
    m.variance = max(sums->variance[e], 0.0f) / (d.distinct_shifts * d.images);
    return m;
}

/* The aspect image or, with noise, one draw of it, see `one_draw`. */
DEVICE REAL grey_of(Sums *sums, Design d, int e) {
    if (d.noise == 0.0f) {
        return d.full_scale * sums->mean[e] / d.distinct_shifts;
    }
    return one_draw(moments_of(sums, d, e), sums->normal, d.full_scale);
}

/* Stores a value of each of a work-item's pixels in a plane, as a float or as a byte. */
#define SCATTER(value, plane, to, kind)                                                       \
    for (int lane = 0; lane < WIDTH; lane++) {                                                \
        uint place = to[get_global_id(0) * WIDTH + lane];                                     \
        if (place != NO_PIXEL) {                                                              \
            (plane)[place] = (kind)LANE(value, lane);                                         \
        }                                                                                     \
    }

/* Aspect images over whole periods in equal steps, or one draw of each, planes of so many `places`. */
__kernel void aspects_of_refined(__global float *grey_levels, uint places, SEEN) {
    Sums sums = sums_of_images(AS_GIVEN);
    for (int e = 0; e < count; e++) {
        REAL grey = grey_of(&sums, *design, e);
        SCATTER(grey, grey_levels + e * (size_t)places, to, float)
    }
}

/* Mean and standard deviation of a noisy one over all its draws, a plane each. */
__kernel void moments_of_refined(__global float *planes, uint places, SEEN) {
    Sums sums = sums_of_images(AS_GIVEN);
    Moments m = moments_of(&sums, *design, 0);
    REAL deviation = sqrt(m.variance);
    SCATTER(m.mean, planes, to, float)
    SCATTER(deviation, planes + places, to, float)
}

/* Levels of what `aspects_of_refined` makes. */
__kernel void levels_of_refined(__global uchar *levels, uint places, SEEN, float per_dn) {
    Sums sums = sums_of_images(AS_GIVEN);
    for (int e = 0; e < count; e++) {
        REAL level = level_of(grey_of(&sums, *design, e), per_dn);
        SCATTER(level, levels + e * (size_t)places, to, uchar)
    }
}

/* How often each level comes in stretches of the same kind, and the highest of each stretch, exposure by
   exposure, the first of which is that of a design. The pixels of stretch i are those from first[i] to
   first[i + 1]. */
__kernel void count_refined(__global uint *counts, __global uint *highest,
                            __global const uchar *levels, __global const uint *first,
                            __global const uint *kinds, uint places, uint design) {
    size_t e = get_global_id(0), stretch = get_global_id(1);
    uint own[LEVELS];
    for (int i = 0; i < LEVELS; i++) {
        own[i] = 0u;
    }
    __global const uchar *level = levels + e * (size_t)places;
    for (uint at = first[stretch]; at < first[stretch + 1]; at++) {
        own[level[at]]++;
    }
    uint peak = 0u;
    for (uint i = 0; i < LEVELS; i++) {
        if (own[i] > 0u) {
            atomic_add(counts + ((design + e) * KINDS + kinds[stretch]) * LEVELS + i, own[i]);
            peak = i;
        }
    }
    highest[(design + e) * get_global_size(1) + stretch] = peak;
}
