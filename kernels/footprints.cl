/* Pixels of many sub-rays: what they see of the light is added up once, for every design. With F(l) the
   share of a pixel's footprint before the light coordinate l, its lit fraction is the sum of 1 - F at
   the edges where the light begins, less that where it ends, whatever the stripes are: F stands in a
   table, its values and slopes at equal steps, a cubic between two of them. An edge is looked up only
   where it cuts the footprint. */
#include "portable.h"
#include "station.h"
#include "light_map.h"

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
#define NUMBERS ((int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))

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
    STORE((lit ? count : none), steps, own + at);
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

/* Adds to the images from `c` up to `end` of a period's `images` what of a footprint lies beyond edges `x` + n
   `step`, n = 0, 1, ..., the first of which cuts it in image j. */
DEVICE void add_edges(float *lit, int c, int end, int images, int j, float x, float step,
                      __global const float2 *nodes, int steps, float sign) {
    int edges = (int)-floor((x - (float)steps) / step);
    for (int turn = c - j; turn < edges; turn += images) {
        int to = turn + end - c < edges ? turn + end - c : edges;
        for (int n = turn > 0 ? turn : 0; n < to; n++) {
            float place = x + step * (float)n;
            int k = (int)place;
            k = k < steps ? k : steps - 1;
            float t = place - (float)k;
            float2 a = nodes[k], b = nodes[k + 1];
            float rise = b.x - a.x;
            float cubic = (a.y + b.y) - 2.0f * rise;
            float value = a.x + t * (a.y + t * ((rise - a.y - cubic) + t * cubic));
            lit[n - turn] += sign * (1.0f - value);
        }
    }
}

/* Mean over whole periods in equal steps under designs that differ in exposure alone, one plane each,
   without noise. Pixels without a table become 0. */
__kernel void means_of_footprints(__global float *means, __global const float2 *nodes,
                                  __global const uint *first, __global const float *begin,
                                  __global const float *step, __global const float *whole,
                                  __global const Design *restrict design,
                                  __global const float *restrict exposures, int count) {
    Design d = *design;
    size_t at = get_global_id(0);
    size_t plane = get_global_size(0);
    uint from = first[at];
    int steps = (int)(first[at + 1] - from) - 1;
    if (steps <= 0) {
        for (int e = 0; e < count; e++) {
            means[e * plane + at] = 0.0f;
        }
        return;
    }
    int images = (int)d.distinct_shifts;
    /* Of the edges where light begins number i = j + K m is that of image j at s_j + m, j / K = s_j; in
       steps from image to image it stands at i, the footprint's begin at `start`. */
    float start = begin[at] * d.periods_per_mm * d.distinct_shifts;
    float between = 1.0f / (step[at] * d.periods_per_mm * d.distinct_shifts);
    float end = start - d.luminous_share * d.distinct_shifts;
    float rising = -floor(-start), falling = -floor(-end);
    int j = (int)rising % images, j_end = (int)falling % images;
    j += j < 0 ? images : 0;
    j_end += j_end < 0 ? images : 0;
    int lit_images = (int)(rising - falling); /* that the footprint's begin sees lit */
    float full = whole[at];
    float dark = full * (d.dark_leak + d.diffuse);
    float bright = full * (1.0f - d.dark_leak);
    float sums[EXPOSURES];
    for (int e = 0; e < count; e++) {
        sums[e] = 0.0f;
    }
    for (int c = 0; c < images; c += IMAGES) {
        int last = c + IMAGES < images ? c + IMAGES : images;
        union {
            float16 some[IMAGES / 16];
            float one[IMAGES];
        } lit;
        int vectors = (last - c + 15) / 16;
        for (int v = 0; v < vectors; v++) {
            int16 since = c + 16 * v - j_end + NUMBERS;
            since += since < 0 ? images : 0;
            lit.some[v] = since < lit_images ? (float16)1.0f : (float16)0.0f;
        }
        __global const float2 *own = nodes + from;
        add_edges(lit.one, c, last, images, j, (rising - start) * between, between, own, steps,
                  1.0f);
        add_edges(lit.one, c, last, images, j_end, (falling - end) * between, between, own, steps,
                  -1.0f);
        for (int v = 0; v < vectors; v++) {
            lit.some[v] = c + 16 * v + NUMBERS < last ? dark + bright * lit.some[v] : 0.0f;
        }
        for (int e = 0; e < count; e++) {
            float16 sum = 0.0f;
            for (int v = 0; v < vectors; v++) {
                float16 signal = exposures[e] * lit.some[v];
                sum += signal < 1.0f ? signal : 1.0f;
            }
            float8 eight = sum.lo + sum.hi;
            float4 four = eight.lo + eight.hi;
            sums[e] += (four.x + four.y) + (four.z + four.w);
        }
    }
    for (int e = 0; e < count; e++) {
        means[e * plane + at] = d.full_scale * sums[e] / d.distinct_shifts;
    }
}
