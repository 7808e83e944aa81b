/* Pixels of many sub-rays: what they see of the light is added up once, for all stripes. With F(l) the
   share of a pixel's footprint before the light coordinate l, its lit fraction is the sum of 1 - F at
   the edges where the light begins, less that where it ends, whatever the stripes are: F stands in a
   table, its values and slopes at equal steps, a cubic between two of them. An edge is looked up only
   where it cuts the footprint. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "light_map.h"

/* What a sub-ray sees of the light, in steps of the table: the side of a trapezoid from its foot on. */
typedef struct {
    REAL foot;
    REAL flank;
    REAL corner;
    REAL bend;   /* 1/2 corner */
    REAL weight; /* share of the pixel's irradiance over the flank */
} Kernel;

/* Where the footprint of each of WIDTH pixels begins, how long the steps of its table are, in mm, how many, and
   the irradiance of all its sub-rays. The cubic is off, in shares of the whole, by the step squared
   times the curvatures 1/w1 w2 of the sub-rays' kernels, which add up by their squares. */
__kernel void measure_footprints(__global float *begin, __global float *step,
                                 __global float *steps, __global float *whole, LIGHT_MAP(const),
                                 int sub_rays, uint plane, uint own, float bound) {
    size_t at = get_global_id(0) * WIDTH;
    REAL none = 0.0f;
    REAL low = 1e30f;
    REAL high = -1e30f;
    REAL sum = 0.0f;
    REAL squares = 0.0f;
    for (int i = 0; i < sub_rays; i++) {
        Ray ray = RAY_AT(at + i * (size_t)plane);
        MASK seen = ray.irradiance > 0.0f;
        REAL reach = 0.5f * (ray.wide + ray.narrow);
        low = (seen ? min(low, ray.light - reach) : low);
        high = (seen ? max(high, ray.light + reach) : high);
        REAL weight = (seen ? ray.irradiance : none);
        REAL bent = weight / (ray.wide * max(ray.narrow, ray.wide * (1.0f / 32.0f)));
        sum += weight;
        squares += bent * bent;
    }
    MASK lit = sum > 0.0f;
    REAL share = max(sum, 1e-30f);
    REAL length = (lit ? high - low : none);
    REAL count = max(-floor(-length * sqrt(sqrt(squares) / (share * bound))), none + 1.0f);
    STORE((lit ? low : none), begin, own + at);
    STORE((lit ? length / count : none + 1.0f), step, own + at);
    STORE((lit ? count : none + 1.0f), steps, own + at);
    STORE(sum / (float)sub_rays, whole, own + at);
}

/* The tables of WIDTH pixels: values and slopes at their nodes, those of pixel i from first[i] up to
   first[i + 1]. A sub-ray adds what its trapezoid rises by from node to node, so that sums over nodes are F. */
__kernel void lay_footprints(__global float2 *nodes, __global const uint *first,
                             __global const float *begin, __global const float *step,
                             __global const float *whole, LIGHT_MAP(const), int sub_rays,
                             uint plane, uint own) {
    size_t at = get_global_id(0) * WIDTH;
    Kernel kernels[SUB_RAYS];
    REAL per_mm = 1.0f / LOAD(step, own + at);
    REAL share = 1.0f / max(LOAD(whole, own + at) * (float)sub_rays, 1e-30f);
    for (int i = 0; i < sub_rays; i++) {
        Ray ray = RAY_AT(at + i * (size_t)plane);
        kernels[i].flank = ray.wide * per_mm;
        kernels[i].corner = max(ray.narrow * per_mm, 1e-3f);
        kernels[i].foot = (ray.light - LOAD(begin, own + at)) * per_mm
                          - 0.5f * (kernels[i].flank + kernels[i].corner);
        kernels[i].bend = 0.5f / kernels[i].corner;
        kernels[i].weight = ray.irradiance * share / kernels[i].flank;
    }
    REAL none = 0.0f;
    for (int lane = 0; lane < WIDTH; lane++) {
        uint from = first[own + at + lane];
        int count = (int)(first[own + at + lane + 1] - from);
        float rise[TABLE_STEPS + 1 + WIDTH];
        float slope[TABLE_STEPS + 1 + WIDTH];
        for (int k = 0; k < count; k += WIDTH) {
            STORE_PRIVATE(none, rise, k);
            STORE_PRIVATE(none, slope, k);
        }
        for (int i = 0; i < sub_rays && count > 0; i++) {
            float weight = LANE(kernels[i].weight, lane);
            float foot = LANE(kernels[i].foot, lane);
            Trapezoid side;
            side.flank = LANE(kernels[i].flank, lane);
            side.corner = LANE(kernels[i].corner, lane);
            side.bend = LANE(kernels[i].bend, lane);
            int k = foot > 0.0f ? (int)foot + 1 : 0;
            float end = foot + LANE(kernels[i].flank, lane) + LANE(kernels[i].corner, lane) + 1.0f;
            for (; weight > 0.0f && k < end && k < count; k += WIDTH) {
                REAL y = ((float)k - foot) + LANES;
                REAL more = risen(side, y) - risen(side, y - 1.0f);
                STORE_PRIVATE(LOAD_PRIVATE(rise, k) + weight * more, rise, k);
                STORE_PRIVATE(LOAD_PRIVATE(slope, k) + weight * rising(side, y), slope, k);
            }
        }
        float sum = 0.0f;
        for (int k = 0; k < count; k++) {
            sum += rise[k];
            nodes[from + k] = (float2)(sum, slope[k]);
        }
    }
}
