/* The light map's entry of one sub-ray. The including shader says how a record is fetched:
   GROOVE(i), BLOCK_FIRST(b), PIECE(i), MAP(i), COEFFICIENT(i); and has `g` (Geometry), `map_count`.
   The plumbing of `kernels/trace.cl`, in GLSL. */
#define BLOCK 16
#ifndef NEWTON_STEPS
#define NEWTON_STEPS 4
#endif

Surface grooves_at(Surface s, int first, int last, float column, float row, vec2 sub, vec2 shift) {
    Nearest nearest;
    float owner = -1.0;
    Groove last_one;
    for (int i = first; i < last; i++) {
        Groove groove = GROOVE(PIECE(i));
        float p = g.sampling;
        float dx = offset_mm(column, sub.x, groove.column, groove.column_fraction, p) + shift.x;
        float dy = shift.y - offset_mm(row, sub.y, groove.row, groove.row_fraction, p);
        Nearest point = nearest_point(dx, dy, groove);
        if (groove.defect == owner) {
            nearest = nearer(nearest, point);
        } else {
            if (owner >= 0.0) {
                s = add_surface(s, gaussian_groove(nearest, last_one.height, last_one.inverse_variance));
            }
            nearest = point;
        }
        owner = groove.defect;
        last_one = groove;
    }
    if (owner >= 0.0) {
        s = add_surface(s, gaussian_groove(nearest, last_one.height, last_one.inverse_variance));
    }
    return s;
}

Surface map_at(Map map, float u, float v) {
    float i = clamp(floor(u), 0.0, map.points_x - 2.0);
    float j = clamp(floor(v), 0.0, map.points_y - 2.0);
    u -= i;
    v -= j;
    int width = int(map.points_x) + 2;
    int at = int(i) + int(j) * width + int(map.first_low) + 65536 * int(map.first_high);
    Spline value = spline_value(u);
    Spline slope = spline_slope(u);
    Spline curve = spline_curve(u);
    float z[4];
    float zx[4];
    float zxx[4];
    for (int k = 0; k < 4; k++) {
        float c0 = COEFFICIENT(at);
        float c1 = COEFFICIENT(at + 1);
        float c2 = COEFFICIENT(at + 2);
        float c3 = COEFFICIENT(at + 3);
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
    s.curve_yy = spline_sum(bend, z[0], z[1], z[2], z[3]) * map.points_per_mm_y * map.points_per_mm_y;
    return s;
}

Surface maps_at(Surface s, float column, float row, vec2 sub, vec2 shift) {
    for (int m = 0; m < map_count; m++) {
        Map map = MAP(m);
        float p = g.sampling;
        float u = (offset_mm(column, sub.x, map.column, map.column_fraction, p) + shift.x) * map.points_per_mm_x;
        float v = (shift.y - offset_mm(row, sub.y, map.row, map.row_fraction, p)) * map.points_per_mm_y;
        if (u >= -0.5 && u <= map.points_x - 0.5 && v >= -0.5 && v <= map.points_y - 0.5) {
            s = add_surface(s, map_at(map, u, v));
        }
    }
    return s;
}

/* Sub-ray `index` of the pixel at (column, row) of the whole image. */
Sight sub_ray(int column, int row, int index) {
    int side = int(g.subsampling);
    vec2 sub = (vec2(float(index % side), float(index / side)) + 0.5) / g.subsampling;
    int block = (row / BLOCK) * (int(g.columns - 1.0) / BLOCK + 1)
                + min(column, int(g.columns) - 1) / BLOCK;
    int first = BLOCK_FIRST(block);
    int last = BLOCK_FIRST(block + 1);
    float c = float(column);
    float r = float(row);
    float h = g.camera_height;
    float x0 = ((c - 0.5 * g.columns) + sub.x) * g.sampling;
    float y0 = ((0.5 * g.rows - r) - sub.y) * g.sampling;
    float z = 0.0;
    int steps = g.rises > 0.0 ? NEWTON_STEPS : 0;
    Surface s;
    for (int k = 0; k <= steps; k++) {
        vec2 shift = vec2(-x0 * z / h, -y0 * z / h);
        s = crown(x0 + shift.x, y0 + shift.y, g.curvature_x, g.curvature_y);
        s = grooves_at(s, first, last, c, r, sub, shift);
        s = maps_at(s, c, r, sub, shift);
        if (k < steps) {
            z = newton_height(z, s, x0, y0, h);
        }
    }
    return sight(g, s, x0, y0, z);
}
