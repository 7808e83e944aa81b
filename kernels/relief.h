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
    WITHIN sub_x;
    WITHIN sub_y;
    REAL shift_x; /* mm */
    REAL shift_y;
};

/* Number of the BLOCK x BLOCK pixels of an image that a pixel lies in; a block lists the grooves
   that reach it. What pads a row is of its last block. */
DEVICE int block_of(int column, int row, int columns) {
    int last = columns - 1;
    return (row / BLOCK) * (last / BLOCK + 1) + (column < last ? column : last) / BLOCK;
}

/* From where a record begins to a place, mm. */
STRUCT(Away) {
    REAL x;
    REAL y;
};

DEVICE Away away_from(Place at, Groove record, float sampling) {
    Away away;
    away.x = offset_mm(at.column, at.sub_x, record.column, record.column_fraction, sampling)
             + at.shift_x;
    away.y = at.shift_y
             - offset_mm(at.row, at.sub_y, record.row, record.row_fraction, sampling);
    return away;
}

/* Sum of the grooves that reach the block; pieces of one defect stand together and the nearest
   counts. */
DEVICE Surface grooves_at(Surface s, Lists lists, int first, int last, Place at, float sampling) {
    Nearest nearest;
    Groove groove;
    float defect = -1.0f;
    for (int i = first; i < last; i++) {
        Groove piece = GROOVE(lists, PIECE(lists, i));
        Away away = away_from(at, piece, sampling);
        Nearest point = nearest_point(away.x, away.y, piece);
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

/* What the edge defects of a block, its last pieces, say of a point: 1 of the part, -1 beside it, 0
   nothing. Of several that it is in, the first says. */
DEVICE REAL outline_at(Lists lists, int first, int last, Place at, float sampling) {
    REAL said = 0.0f;
    for (int i = last - 1; i >= first; i--) {
        Groove edge = GROOVE(lists, PIECE(lists, i));
        if (edge.outline == 0.0f) {
            break;
        }
        Away away = away_from(at, edge, sampling);
        REAL says = edge.outline;
        said = in_ellipse(away.x, away.y, edge) ? says : said;
    }
    return said;
}

#ifdef MIXED_BLOCKS
/* Both for neighbours in a REAL that may lie in different blocks: `lists` has the pieces of each
   block among them, and whose it is. */
DEVICE Surface mixed_grooves_at(Surface s, Lists lists, Place at, float sampling) {
    for (int i = 0; i < lists.blocks; i++) {
        Surface with = grooves_at(s, lists, lists.first[i], lists.last[i], at, sampling);
        MASK mine = lists.mine[i];
        s.height = mine ? with.height : s.height;
        s.slope_x = mine ? with.slope_x : s.slope_x;
        s.slope_y = mine ? with.slope_y : s.slope_y;
        s.curve_xx = mine ? with.curve_xx : s.curve_xx;
        s.curve_xy = mine ? with.curve_xy : s.curve_xy;
        s.curve_yy = mine ? with.curve_yy : s.curve_yy;
    }
    return s;
}

/* What the edge defects of those blocks say. */
DEVICE REAL mixed_outline_at(Lists lists, Place at, float sampling) {
    REAL said = 0.0f;
    for (int i = 0; i < lists.blocks; i++) {
        REAL says = outline_at(lists, lists.first[i], lists.last[i], at, sampling);
        said = lists.mine[i] ? says : said;
    }
    return said;
}
#endif

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

/* What the edge defects of a place's block say of it. */
DEVICE REAL block_outline(Lists lists, int first, int last, Place at, float sampling) {
    REAL outline = 0.0f;
#ifdef MIXED_BLOCKS
    outline = mixed_outline_at(lists, at, sampling);
#else
    if (first < last) {
        outline = outline_at(lists, first, last, at, sampling);
    }
#endif
    return outline;
}

/* Shape and relief at a place, (x0, y0) less its shift. */
DEVICE Surface part_at(Geometry g, Lists lists, int first, int last, Place at, REAL x0, REAL y0) {
    Surface s = shape_at(g, x0 + at.shift_x, y0 + at.shift_y);
#ifdef MIXED_BLOCKS
    s = mixed_grooves_at(s, lists, at, g.sampling);
#else
    if (first < last) {
        s = grooves_at(s, lists, first, last, at, g.sampling);
    }
#endif
    return maps_at(s, lists, at, g.sampling);
}

#ifdef POSED

/* Whether a ray from the part's point `from`, at a place, dips below the part: looked at in steps that
   grow with their number, until it is above the highest point or at the part's edge. Of grooves those
   count that reach its pixel's block. */
DEVICE MASK meets_part(Geometry g, Lists lists, int first, int last, Place at, REAL x0, REAL y0,
                       Vector from, Vector ray) {
    REAL x = (ray.x < 0.0f ? -from.x : from.x);
    REAL y = (ray.y < 0.0f ? -from.y : from.y);
    REAL way = min((g.half_length - x) / max(fabs(ray.x), 1e-6f),
                   (g.half_width - y) / max(fabs(ray.y), 1e-6f));
    REAL up = max(g.highest - from.z, 0.0f) / max(ray.z, 1e-6f);
    way = max(ray.z > 0.0f ? min(way, up) : way, 0.0f);
    MASK met = way < 0.0f;
    int steps = INT(g.march_steps);
    for (int i = 1; i <= steps; i++) {
        float share = FLOAT(i) / g.march_steps;
        Vector to = along(from, share * share * way, ray);
        at.shift_x = to.x - x0;
        at.shift_y = to.y - y0;
        Surface s = part_at(g, lists, first, last, at, x0, y0);
        met = met || to.z < s.height - g.march_slack;
    }
    return met;
}

/* What a place's ray sees of a posed part, or of one that it may meet twice: by Newton's method from
   the highest point on, if so. */
DEVICE Sight posed_sub_ray(Geometry g, Lists lists, int first, int last, Place at, REAL u, REAL v) {
    Aim aim = aim_at(g, u, v);
    Vector look = aim.direction;
    float begin = g.march_steps > 0.0f ? g.highest : 0.0f;
    REAL way = (begin - aim.away.z) / look.z;
    Surface s;
    int steps = g.rises > 0.0f ? POSED_STEPS : 0;
    REAL miss = 0.0f;
    for (int k = 0; k <= steps; k++) {
        at.shift_x = aim.away.x + way * look.x;
        at.shift_y = aim.away.y + way * look.y;
        s = part_at(g, lists, first, last, at, u, v);
        miss = aim.away.z + way * look.z - s.height;
        if (k < steps) {
            way -= miss / (look.z - s.slope_x * look.x - s.slope_y * look.y);
        }
    }
    CameraRay c = posed_ray(g, aim, u, v, way);
    MASK hidden = way != way;
    MASK again = hidden;
    if (g.march_steps > 0.0f) {
        Vector back = scaled(-1.0f, look);
        Mirror m = mirror_of(c, s);
        hidden = fabs(miss) > g.march_slack
                 || meets_part(g, lists, first, last, at, u, v, c.point, back);
        again = meets_part(g, lists, first, last, at, u, v, c.point, m.ray);
    }
    REAL outline = block_outline(lists, first, last, at, g.sampling);
    return posed_sight(g, s, c, (at.sub_x - 0.5f) * g.sampling, (0.5f - at.sub_y) * g.sampling,
                       outline, hidden, again);
}

#endif

#ifndef POSED

/* Where a place's ray meets the part. */
STRUCT(Meeting) {
    Surface surface;
    Place at;
    REAL z;
};

/* Where the ray through (x0, y0, 0) does, by Newton's method where the surface rises. */
DEVICE Meeting meeting_of(Geometry g, Lists lists, int first, int last, Place at, REAL x0,
                          REAL y0) {
    float inverse = 1.0f / g.camera_height;
    Meeting m;
    m.z = 0.0f;
    m.at = at;
    int steps = g.rises > 0.0f ? NEWTON_STEPS : 0;
    for (int k = 0; k <= steps; k++) {
        m.at.shift_x = -x0 * (m.z * inverse);
        m.at.shift_y = -y0 * (m.z * inverse);
        m.surface = part_at(g, lists, first, last, m.at, x0, y0);
        if (k < steps) {
            m.z = newton_height(m.z, m.surface, x0, y0, g.camera_height);
        }
    }
    return m;
}

#endif

#ifndef SLICED

/* Sub-ray `index` of the pixel at (column, row) of the whole image, its block's grooves being
   `first` to `last`: where it meets the part, and what it sees there. */
DEVICE Sight sub_ray(Geometry g, Lists lists, int first, int last, REAL column, REAL row,
                     int index) {
    int side = INT(g.subsampling);
    Place at;
    at.column = column;
    at.row = row;
    at.sub_x = (FLOAT(index % side) + 0.5f) / g.subsampling;
    at.sub_y = (FLOAT(index / side) + 0.5f) / g.subsampling;
    at.sub_x += spot_offset(g, at.sub_x - 0.5f);
    at.sub_y += spot_offset(g, at.sub_y - 0.5f);
    REAL x0 = ((column - 0.5f * g.columns) + at.sub_x) * g.sampling;
    REAL y0 = ((0.5f * g.rows - row) - at.sub_y) * g.sampling;
#ifdef POSED
    return posed_sub_ray(g, lists, first, last, at, x0, y0);
#else
    Meeting m = meeting_of(g, lists, first, last, at, x0, y0);
    return sight_from(g, m.surface, x0, y0, m.z, (at.sub_x - 0.5f) * g.sampling,
                      (0.5f - at.sub_y) * g.sampling,
                      block_outline(lists, first, last, m.at, g.sampling));
#endif
}

#else

/* Direction of a groove, a unit vector. */
STRUCT(Course) {
    REAL square; /* of its distance, mm */
    REAL x;
    REAL y;
};

/* The nearest of a block's grooves, if it is nearer than `c`. */
DEVICE Course nearest_course(Course c, Lists lists, int first, int last, Place at, float sampling) {
    for (int i = first; i < last; i++) {
        Groove piece = GROOVE(lists, PIECE(lists, i));
        Away away = away_from(at, piece, sampling);
        Nearest point = nearest_point(away.x, away.y, piece);
        MASK nearer = point.square < c.square;
        c.square = nearer ? point.square : c.square;
        c.x = nearer ? piece.inverse_length * piece.along_x : c.x;
        c.y = nearer ? piece.inverse_length * piece.along_y : c.y;
    }
    return c;
}

/* The groove that crosses the pixel at (column, row): the nearest to where its centre meets the
   shape. */
DEVICE Course course_at(Geometry g, Lists lists, int first, int last, REAL column, REAL row) {
    REAL none = 0.0f;
    REAL x0 = ((column - 0.5f * g.columns) + 0.5f) * g.sampling;
    REAL y0 = ((0.5f * g.rows - row) - 0.5f) * g.sampling;
    float inverse = 1.0f / g.camera_height;
    Place at;
    at.column = column;
    at.row = row;
    at.sub_x = none + 0.5f;
    at.sub_y = none + 0.5f;
    at.shift_x = none;
    at.shift_y = none;
    REAL z = none;
    int steps = g.rises > 0.0f ? NEWTON_STEPS : 0;
    for (int k = 0; k < steps; k++) {
        REAL share = 1.0f - z * inverse;
        Surface s = shape_at(g, x0 * share, y0 * share);
        z = newton_height(z, s, x0, y0, g.camera_height);
        at.shift_x = -x0 * (z * inverse);
        at.shift_y = -y0 * (z * inverse);
    }
    Course c;
    c.square = none + 1e30f;
    c.x = none + 1.0f;
    c.y = none;
#ifdef MIXED_BLOCKS
    for (int i = 0; i < lists.blocks; i++) {
        Course with = nearest_course(c, lists, lists.first[i], lists.last[i], at, g.sampling);
        MASK mine = lists.mine[i];
        c.square = mine ? with.square : c.square;
        c.x = mine ? with.x : c.x;
        c.y = mine ? with.y : c.y;
    }
#else
    c = nearest_course(c, lists, first, last, at, g.sampling);
#endif
    return c;
}

/* Slice `index` of the pixel at (column, row) of the whole image along its groove, its block's grooves
   being `first` to `last`: what its ray sees. */
DEVICE Sight slice_ray(Geometry g, Lists lists, int first, int last, REAL column, REAL row,
                       Course groove, int index) {
    Slice slice = slice_of(-groove.y, groove.x, index, INT(g.subsampling));
    Place at;
    at.column = column;
    at.row = row;
    at.sub_x = 0.5f + slice.x;
    at.sub_y = 0.5f - slice.y;
    REAL x0 = ((column - 0.5f * g.columns) + at.sub_x) * g.sampling;
    REAL y0 = ((0.5f * g.rows - row) - at.sub_y) * g.sampling;
    Meeting m = meeting_of(g, lists, first, last, at, x0, y0);
    CameraRay c = camera_ray(x0, y0, m.z, g.camera_height);
    c.slice = slice;
    return slice_sight(g, m.surface, c, block_outline(lists, first, last, m.at, g.sampling));
}

/* The same, its groove not known. */
DEVICE Sight sub_ray(Geometry g, Lists lists, int first, int last, REAL column, REAL row,
                     int index) {
    return slice_ray(g, lists, first, last, column, row,
                     course_at(g, lists, first, last, column, row), index);
}

#endif

#endif
