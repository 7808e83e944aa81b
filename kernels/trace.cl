/* The light map: one work-item for WIDTH neighbouring pixels of a row, or with LISTED for WIDTH pixels
   of a list. */
#include "portable.h"
#include "station.h"
#include "light_map.h"
#include "surface.h"
#include "reflection.h"

/* The station's lists, in buffers. */
typedef struct {
    __global const Groove *grooves;
    __global const int *pieces;
    __global const Map *map_records;
    __global const float *coefficients;
    int maps;
#ifdef MIXED_BLOCKS
    int blocks; /* with grooves, among the pixels */
    int first[WIDTH];
    int last[WIDTH];
    MASK mine[WIDTH];
#endif
} Lists;

#define PIECE(lists, i) (lists).pieces[i]
#define GROOVE(lists, i) (lists).grooves[i]
#define MAP(lists, i) (lists).map_records[i]
#define COEFFICIENT(lists, at) GATHER((lists).coefficients, at)
#include "relief.h"

/* Writes what a work-item's pixels see, `at` places from the beginning of every plane; `there` are
   those that are pixels of the image. A call would cost a fifth of the time. */
__attribute__((always_inline)) DEVICE void
trace_to(LIGHT_MAP(), __global uchar *lost, Geometry g, Lists lists, int first, int last,
         REAL column, REAL row, MASK there, int rays, size_t at, size_t plane) {
    REAL reason = LOST_BESIDE;
    REAL dark = 0.0f; /* what is no pixel sees no light */
#ifdef SLICED
    Course course = course_at(g, lists, first, last, column, row);
#endif
    for (int i = 0; i < rays; i++) {
#ifdef SLICED
        Sight v = slice_ray(g, lists, first, last, column, row, course, i);
#else
        Sight v = sub_ray(g, lists, first, last, column, row, i);
#endif
        STORE(v.light, light, at + i * plane);
        STORE(v.wide, wide, at + i * plane);
        STORE(v.narrow, narrow, at + i * plane);
        STORE(there ? v.irradiance : dark, irradiance, at + i * plane);
        reason = loss_of_both(reason, v.lost);
    }
    STORE_BYTE(reason, lost, at);
}

#ifdef SLICED
#define RAYS(g) ((int)(g).subsampling)
#else
#define RAYS(g) ((int)((g).subsampling * (g).subsampling))
#endif

#ifdef LISTED

/* Light map of pixels, numbered row by row through the whole image, laid in `rows` rows. */
__kernel void trace_listed(LIGHT_MAP(), __global uchar *lost,
                           __global const Geometry *restrict geometry,
                           __global const Groove *grooves, __global const int *block_first,
                           __global const int *pieces, __global const Map *maps, int map_count,
                           __global const float *coefficients, __global const uint *pixels,
                           int first_row, int rows) {
    Geometry g = *geometry;
    Lists lists = {grooves, pieces, maps, coefficients, map_count};
    size_t stride = get_global_size(0) * WIDTH;
    size_t at = get_global_id(1) * stride + get_global_id(0) * WIDTH;
    COUNTER number = LOAD_COUNTERS(pixels, at + stride * (size_t)first_row);
    MASK there = number != NO_PIXEL;
    COUNTER none = 0u;
    number = there ? number : none;
    uint columns = (uint)g.columns;
    COUNTER row = number / columns;
    COUNTER column = number - row * columns;
    COUNTER block = row / BLOCK * ((columns - 1u) / BLOCK + 1u) + column / BLOCK;
    int begin = 0, end = 0;
#ifdef MIXED_BLOCKS
    uint of[WIDTH];
    for (int lane = 0; lane < WIDTH; lane++) {
        uint its = LANE(block, lane);
        if (block_first[its] == block_first[its + 1]) {
            continue;
        }
        int known = 0;
        while (known < lists.blocks && of[known] != its) {
            known++;
        }
        if (known == lists.blocks) {
            of[known] = its;
            lists.first[known] = block_first[its];
            lists.last[known] = block_first[its + 1];
            lists.mine[known] = TO_MASK(block == its);
            lists.blocks++;
        }
    }
#else
    begin = block_first[block];
    end = block_first[block + 1];
#endif
    trace_to(light, wide, narrow, irradiance, lost, g, lists, begin, end, TO_REAL(column),
             TO_REAL(row), there, RAYS(g), at, stride * (size_t)rows);
}

#else

/* Where the light map of a tile goes, `rows` of the image from first_row on, and of what. */
#define TILE                                                                                    \
    LIGHT_MAP(), __global uchar *lost, __global const Geometry *restrict geometry,              \
        __global const Groove *grooves, __global const int *block_first,                        \
        __global const int *pieces, __global const Map *maps, int map_count,                    \
        __global const float *coefficients, int first_row, int rows

/* Light map of a tile: light coordinate, footprint and irradiance of each of a pixel's rays, one
   plane after another, and per pixel why it sees no light. */
#define TRACE_TILE(number)                                                                       \
    Geometry g = *geometry;                                                                     \
    Lists lists = {grooves, pieces, maps, coefficients, map_count};                             \
    size_t stride = get_global_size(0) * WIDTH;                                                 \
    size_t at = get_global_id(1) * stride + get_global_id(0) * WIDTH;                           \
    int left = (int)get_global_id(0) * WIDTH;                                                   \
    int top = first_row + (int)get_global_id(1);                                                \
    int block = block_of(left, top, (int)g.columns);                                            \
    REAL column = (float)left + LANES;                                                          \
    REAL row = (float)top;                                                                      \
    trace_to(light, wide, narrow, irradiance, lost, g, lists, block_first[block],               \
             block_first[block + 1], column, row, column < g.columns, number, at,               \
             stride * (size_t)rows);

__kernel void trace_sub_rays(TILE) {
    TRACE_TILE(RAYS(g))
}

/* One ray a pixel, in a kernel of its own: a loop over one costs a fifth. */
__kernel void trace(TILE) {
    TRACE_TILE(1)
}

#endif
