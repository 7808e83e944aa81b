/* The light map: one work-item for WIDTH neighbouring pixels of a row. */
#include "portable.h"
#include "station.h"
#include "surface.h"
#include "reflection.h"

/* The station's lists, in buffers. */
typedef struct {
    __global const Groove *grooves;
    __global const int *pieces;
    __global const Map *map_records;
    __global const float *coefficients;
    int maps;
} Lists;

#define PIECE(lists, i) (lists).pieces[i]
#define GROOVE(lists, i) (lists).grooves[i]
#define MAP(lists, i) (lists).map_records[i]
#define COEFFICIENT(lists, at) GATHER((lists).coefficients, at)
#include "relief.h"

/* Light map of a tile, `rows` of the image from first_row on: light coordinate, footprint and
   irradiance of each sub-ray, one plane after another, and per pixel why it sees no light. */
__kernel void trace(__global float *light, __global float *footprint, __global float *irradiance,
                    __global uchar *lost, __global const Geometry *restrict geometry,
                    __global const Groove *grooves, __global const int *block_first,
                    __global const int *pieces, __global const Map *maps, int map_count,
                    __global const float *coefficients, int first_row, int rows) {
    Geometry g = *geometry;
    Lists lists = {grooves, pieces, maps, coefficients, map_count};
    size_t stride = get_global_size(0) * WIDTH;
    size_t at = get_global_id(1) * stride + get_global_id(0) * WIDTH;
    size_t plane = stride * (size_t)rows;
    int left = (int)get_global_id(0) * WIDTH;
    int top = first_row + (int)get_global_id(1);
    int block = block_of(left, top, (int)g.columns);
    int first = block_first[block], last = block_first[block + 1];
    REAL column = (float)left + LANES;
    REAL row = (float)top;
    REAL reason = LOST_BESIDE;
    REAL dark = 0.0f; /* what pads a row to whole vectors sees no light */
    int rays = (int)(g.subsampling * g.subsampling);
    for (int i = 0; i < rays; i++) {
        Sight v = sub_ray(g, lists, first, last, column, row, i);
        STORE(v.light, light, at + i * plane);
        STORE(v.footprint, footprint, at + i * plane);
        STORE(column < g.columns ? v.irradiance : dark, irradiance, at + i * plane);
        reason = loss_of_both(reason, v.lost);
    }
#if WIDTH == 8
    *(__global uchar8 *)(lost + at) = convert_uchar8(reason);
#else
    lost[at] = (uchar)reason;
#endif
}
