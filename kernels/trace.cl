/* The light map: one work-item for WIDTH neighbouring pixels of a row. */
#include "portable.h"
#include "station.h"
#include "surface.h"
#include "reflection.h"

/* Columns and rows of a block of the image; a block lists the grooves that reach it. */
#define BLOCK 16

/* Newton steps to a height surface: the error falls as slope x field angle, squared each time. */
#define NEWTON_STEPS 4

/* Sum of the grooves that reach the block; pieces of one defect stand together and the nearest
   counts. (shift_x, shift_y) is the parallax of the surface point, mm. */
DEVICE Surface grooves_at(Surface s, __global const Groove *grooves, __global const int *pieces,
                          int first, int last, REAL column, REAL row, float sub_x, float sub_y,
                          REAL shift_x, REAL shift_y, float sampling) {
    Nearest nearest;
    for (int i = first; i < last; i++) {
        Groove groove = grooves[pieces[i]];
        REAL dx = offset_mm(column, sub_x, groove.column, groove.column_fraction, sampling) + shift_x;
        REAL dy = shift_y - offset_mm(row, sub_y, groove.row, groove.row_fraction, sampling);
        Nearest point = nearest_point(dx, dy, groove);
        bool same = i > first && grooves[pieces[i - 1]].defect == groove.defect;
        nearest = same ? nearer(nearest, point) : point;
        bool more = i + 1 < last && grooves[pieces[i + 1]].defect == groove.defect;
        if (!more) {
            s = add_surface(s, gaussian_groove(nearest, groove.height, groove.inverse_variance));
        }
    }
    return s;
}

/* Sum of the measured maps at the point. */
DEVICE Surface maps_at(Surface s, __global const Map *maps, int count,
                       __global const float *coefficients, REAL column, REAL row,
                       float sub_x, float sub_y, REAL shift_x, REAL shift_y, float sampling) {
    for (int m = 0; m < count; m++) {
        Map map = maps[m];
        REAL u = (offset_mm(column, sub_x, map.column, map.column_fraction, sampling) + shift_x) * map.points_per_mm_x;
        REAL v = (shift_y - offset_mm(row, sub_y, map.row, map.row_fraction, sampling)) * map.points_per_mm_y;
        /* The outermost points stand for half a pitch beyond them too. */
        MASK on = u >= -0.5f && u <= map.points_x - 0.5f && v >= -0.5f && v <= map.points_y - 0.5f;
        if (!ANY(on)) {
            continue;
        }
        REAL i = clamp(floor(u), 0.0f, map.points_x - 2.0f);
        REAL j = clamp(floor(v), 0.0f, map.points_y - 2.0f);
        u -= i;
        v -= j;
        /* Coefficients carry one more point on each side: point (i - 1, j - 1) is entry (i, j). */
        int width = (int)map.points_x + 2;
        COUNTER at = TO_COUNTER(i) + TO_COUNTER(j) * (uint)width
                     + ((uint)map.first_low + 65536u * (uint)map.first_high);
        Spline value = spline_value(u), slope = spline_slope(u), curve = spline_curve(u);
        REAL z[4], zx[4], zxx[4];
        for (int k = 0; k < 4; k++) {
            REAL c0 = GATHER(coefficients, at);
            REAL c1 = GATHER(coefficients, at + 1u);
            REAL c2 = GATHER(coefficients, at + 2u);
            REAL c3 = GATHER(coefficients, at + 3u);
            z[k] = spline_sum(value, c0, c1, c2, c3);
            zx[k] = spline_sum(slope, c0, c1, c2, c3) * map.points_per_mm_x;
            zxx[k] = spline_sum(curve, c0, c1, c2, c3) * map.points_per_mm_x * map.points_per_mm_x;
            at += (uint)width;
        }
        Spline across = spline_value(v), rise = spline_slope(v), bend = spline_curve(v);
        Surface relief;
        relief.height = spline_sum(across, z[0], z[1], z[2], z[3]);
        relief.slope_x = spline_sum(across, zx[0], zx[1], zx[2], zx[3]);
        relief.slope_y = spline_sum(rise, z[0], z[1], z[2], z[3]) * map.points_per_mm_y;
        relief.curve_xx = spline_sum(across, zxx[0], zxx[1], zxx[2], zxx[3]);
        relief.curve_xy = spline_sum(rise, zx[0], zx[1], zx[2], zx[3]) * map.points_per_mm_y;
        relief.curve_yy = spline_sum(bend, z[0], z[1], z[2], z[3]) * map.points_per_mm_y * map.points_per_mm_y;
        REAL zero = 0.0f;
        s.height += on ? relief.height : zero;
        s.slope_x += on ? relief.slope_x : zero;
        s.slope_y += on ? relief.slope_y : zero;
        s.curve_xx += on ? relief.curve_xx : zero;
        s.curve_xy += on ? relief.curve_xy : zero;
        s.curve_yy += on ? relief.curve_yy : zero;
    }
    return s;
}

/* Light map of rows first_row ... of the image: light coordinate, footprint and irradiance of each
   sub-ray, one plane after another, and per pixel why it sees no light. */
__kernel void trace(__global float *light, __global float *footprint, __global float *irradiance,
                    __global uchar *lost, __constant Geometry *geometry,
                    __global const Groove *grooves, __global const int *block_first,
                    __global const int *pieces, __global const Map *maps, int map_count,
                    __global const float *coefficients, int first_row) {
    Geometry g = *geometry;
    size_t stride = get_global_size(0) * WIDTH;
    size_t at = get_global_id(1) * stride + get_global_id(0) * WIDTH;
    size_t plane = stride * get_global_size(1);
    int left = (int)get_global_id(0) * WIDTH;
    int top = first_row + (int)get_global_id(1);
    int block = (top / BLOCK) * ((int)(g.columns - 1.0f) / BLOCK + 1)
                + (left < (int)g.columns ? left : (int)g.columns - 1) / BLOCK;
    int first = block_first[block], last = block_first[block + 1];
    REAL column = (float)left + LANES;
    REAL row = (float)top;
    float h = g.camera_height, p = g.sampling;
    int side = (int)g.subsampling;
    REAL reason = LOST_BESIDE;
    MASK seen = reason < 0.0f;
    REAL dark = 0.0f; /* what pads a row to whole vectors sees no light */
    for (int i = 0; i < side * side; i++) {
        float sub_x = ((float)(i % side) + 0.5f) / g.subsampling;
        float sub_y = ((float)(i / side) + 0.5f) / g.subsampling;
        REAL x0 = ((column - 0.5f * g.columns) + sub_x) * p;
        REAL y0 = ((0.5f * g.rows - row) - sub_y) * p;
        REAL z = 0.0f;
        Surface s;
        int steps = g.rises > 0.0f ? NEWTON_STEPS : 0;
        for (int k = 0; k <= steps; k++) {
            REAL shift_x = -x0 * z / h, shift_y = -y0 * z / h;
            s = crown(x0 + shift_x, y0 + shift_y, g.curvature_x, g.curvature_y);
            if (first < last) {
                s = grooves_at(s, grooves, pieces, first, last, column, row, sub_x, sub_y,
                               shift_x, shift_y, p);
            }
            s = maps_at(s, maps, map_count, coefficients, column, row, sub_x, sub_y,
                        shift_x, shift_y, p);
            if (k < steps) {
                z = newton_height(z, s, x0, y0, h);
            }
        }
        Sight v = sight(g, s, x0, y0, z);
        STORE(v.light, light, at + i * plane);
        STORE(v.footprint, footprint, at + i * plane);
        STORE(column < g.columns ? v.irradiance : dark, irradiance, at + i * plane);
        reason = (v.lost > reason ? v.lost : reason);
        seen = seen || v.lost == LOST_NOT;
    }
    reason = seen ? 0.0f : reason;
#if WIDTH == 8
    *(__global uchar8 *)(lost + at) = convert_uchar8(reason);
#else
    lost[at] = (uchar)reason;
#endif
}
