/* The part's relief under a pixel, and the light map's entry of one sub-ray. Where a station's
   lists lie is the language's affair: the including program has a struct `Lists`, with the number of
   measured maps in `maps`, and says how it fetches an entry: PIECE(lists, i), GROOVE(lists, i),
   MAP(lists, i) and, for a COUNTER, COEFFICIENT(lists, at). */
#ifndef RELIEF_H
#define RELIEF_H

/* A point of the part as a pixel, a sub-ray in it and the parallax of the surface's height: its
   distance from a record in whole and fractional pixels is exact wherever on the part it is. */
STRUCT(Place) {
    REAL column;
    REAL row;
    float sub_x;
    float sub_y;
    REAL shift_x; /* mm */
    REAL shift_y;
};

/* Number of the BLOCK x BLOCK pixels of an image that a pixel lies in; a block lists the grooves
   that reach it. What pads a row is of its last block. */
DEVICE int block_of(int column, int row, int columns) {
    int last = columns - 1;
    return (row / BLOCK) * (last / BLOCK + 1) + (column < last ? column : last) / BLOCK;
}

/* Sum of the grooves that reach the block; pieces of one defect stand together and the nearest
   counts. */
DEVICE Surface grooves_at(Surface s, Lists lists, int first, int last, Place at, float sampling) {
    Nearest nearest;
    Groove groove;
    float defect = -1.0f;
    for (int i = first; i < last; i++) {
        Groove piece = GROOVE(lists, PIECE(lists, i));
        REAL dx = offset_mm(at.column, at.sub_x, piece.column, piece.column_fraction, sampling)
                  + at.shift_x;
        REAL dy = at.shift_y
                  - offset_mm(at.row, at.sub_y, piece.row, piece.row_fraction, sampling);
        Nearest point = nearest_point(dx, dy, piece);
        if (piece.defect == defect) {
            nearest = nearer(nearest, point);
        } else {
            if (defect >= 0.0f) {
                s = add_surface(s, gaussian_groove(nearest, groove.height,
                                                   groove.inverse_variance));
            }
            nearest = point;
        }
        groove = piece;
        defect = piece.defect;
    }
    if (defect >= 0.0f) {
        s = add_surface(s, gaussian_groove(nearest, groove.height, groove.inverse_variance));
    }
    return s;
}

/* Height, slope and curvature of a measured map at (u, v), in points of its grid: a cubic B-spline
   along x and along y. */
DEVICE Surface map_surface(Lists lists, Map map, REAL u, REAL v) {
    REAL i = clamp(floor(u), 0.0f, map.points_x - 2.0f);
    REAL j = clamp(floor(v), 0.0f, map.points_y - 2.0f);
    u -= i;
    v -= j;
    /* Coefficients carry one more point on each side: point (i - 1, j - 1) is entry (i, j). */
    uint width = UINT(map.points_x) + 2u;
    COUNTER at = TO_COUNTER(i) + TO_COUNTER(j) * width
                 + (UINT(map.first_low) + 65536u * UINT(map.first_high));
    Spline value = spline_value(u);
    Spline slope = spline_slope(u);
    Spline curve = spline_curve(u);
    REAL z[4];
    REAL zx[4];
    REAL zxx[4];
    for (int k = 0; k < 4; k++) {
        REAL c0 = COEFFICIENT(lists, at);
        REAL c1 = COEFFICIENT(lists, at + 1u);
        REAL c2 = COEFFICIENT(lists, at + 2u);
        REAL c3 = COEFFICIENT(lists, at + 3u);
        z[k] = spline_sum(value, c0, c1, c2, c3);
        zx[k] = spline_sum(slope, c0, c1, c2, c3) * map.points_per_mm_x;
        zxx[k] = spline_sum(curve, c0, c1, c2, c3) * map.points_per_mm_x * map.points_per_mm_x;
        at += width;
    }
    Spline across = spline_value(v);
    Spline rise = spline_slope(v);
    Spline bend = spline_curve(v);
    Surface s;
    s.height = spline_sum(across, z[0], z[1], z[2], z[3]);
    s.slope_x = spline_sum(across, zx[0], zx[1], zx[2], zx[3]);
    s.slope_y = spline_sum(rise, z[0], z[1], z[2], z[3]) * map.points_per_mm_y;
    s.curve_xx = spline_sum(across, zxx[0], zxx[1], zxx[2], zxx[3]);
    s.curve_xy = spline_sum(rise, zx[0], zx[1], zx[2], zx[3]) * map.points_per_mm_y;
    s.curve_yy = spline_sum(bend, z[0], z[1], z[2], z[3]) * map.points_per_mm_y
                 * map.points_per_mm_y;
    return s;
}

/* Sum of the measured maps that the point lies on. */
DEVICE Surface maps_at(Surface s, Lists lists, Place at, float sampling) {
    for (int m = 0; m < lists.maps; m++) {
        Map map = MAP(lists, m);
        REAL u = (offset_mm(at.column, at.sub_x, map.column, map.column_fraction, sampling)
                  + at.shift_x) * map.points_per_mm_x;
        REAL v = (at.shift_y - offset_mm(at.row, at.sub_y, map.row, map.row_fraction, sampling))
                 * map.points_per_mm_y;
        /* The outermost points stand for half a pitch beyond them too. */
        MASK on = u >= -0.5f && u <= map.points_x - 0.5f && v >= -0.5f && v <= map.points_y - 0.5f;
        if (!ANY(on)) {
            continue;
        }
        Surface relief = map_surface(lists, map, u, v);
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

/* Sub-ray `index` of the pixel at (column, row) of the whole image, its block's grooves being
   `first` to `last`: the height at which it meets the part, by Newton's method where the surface
   rises, and what it sees there. */
DEVICE Sight sub_ray(Geometry g, Lists lists, int first, int last, REAL column, REAL row,
                     int index) {
    int side = INT(g.subsampling);
    float h = g.camera_height;
    Place at;
    at.column = column;
    at.row = row;
    at.sub_x = (FLOAT(index % side) + 0.5f) / g.subsampling;
    at.sub_y = (FLOAT(index / side) + 0.5f) / g.subsampling;
    REAL x0 = ((column - 0.5f * g.columns) + at.sub_x) * g.sampling;
    REAL y0 = ((0.5f * g.rows - row) - at.sub_y) * g.sampling;
    REAL z = 0.0f;
    Surface s;
    int steps = g.rises > 0.0f ? NEWTON_STEPS : 0;
    for (int k = 0; k <= steps; k++) {
        at.shift_x = -x0 * z / h;
        at.shift_y = -y0 * z / h;
        s = crown(x0 + at.shift_x, y0 + at.shift_y, g.curvature_x, g.curvature_y);
        if (first < last) {
            s = grooves_at(s, lists, first, last, at, g.sampling);
        }
        s = maps_at(s, lists, at, g.sampling);
        if (k < steps) {
            z = newton_height(z, s, x0, y0, h);
        }
    }
    return sight(g, s, x0, y0, z);
}

#endif
