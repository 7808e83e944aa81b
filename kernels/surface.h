/* The part: height, slope and curvature of shape and relief at a point. */
#ifndef SURFACE_H
#define SURFACE_H

/* Height z, its gradient and its second derivatives; lengths in mm. */
STRUCT(Surface) {
    REAL height;
    REAL slope_x;
    REAL slope_y;
    REAL curve_xx;
    REAL curve_xy;
    REAL curve_yy;
};

DEVICE Surface flat_surface() {
    Surface s;
    s.height = 0.0f;
    s.slope_x = 0.0f;
    s.slope_y = 0.0f;
    s.curve_xx = 0.0f;
    s.curve_xy = 0.0f;
    s.curve_yy = 0.0f;
    return s;
}

DEVICE Surface add_surface(Surface a, Surface b) {
    a.height += b.height;
    a.slope_x += b.slope_x;
    a.slope_y += b.slope_y;
    a.curve_xx += b.curve_xx;
    a.curve_xy += b.curve_xy;
    a.curve_yy += b.curve_yy;
    return a;
}

/* Crown: the sum of two sagittas, z = -c u^2 / (1 + sqrt(1 - c^2 u^2)), c = 1/radius.
   This form of R - sqrt(R^2 - u^2) does not cancel. */
DEVICE Surface crown(REAL x, REAL y, float cx, float cy) {
    Surface s = flat_surface();
    if (cx == 0.0f && cy == 0.0f) {
        return s;
    }
    REAL qx = sqrt(max(1.0f - cx * cx * x * x, 1e-6f));
    REAL qy = sqrt(max(1.0f - cy * cy * y * y, 1e-6f));
    s.height = -(cx * x * x) / (1.0f + qx) - (cy * y * y) / (1.0f + qy);
    s.slope_x = -(cx * x) / qx;
    s.slope_y = -(cy * y) / qy;
    s.curve_xx = -cx / (qx * qx * qx);
    s.curve_yy = -cy / (qy * qy * qy);
    return s;
}

/* Sphere: z = -c r^2 / (1 + sqrt(1 - c^2 r^2)), r the distance to the z axis, c = 1/radius. */
DEVICE Surface sphere(REAL x, REAL y, float c) {
    REAL square = x * x + y * y;
    REAL q = 1.0f / sqrt(max(1.0f - c * c * square, 1e-6f));
    REAL even = -c * q;
    REAL more = even * (c * q) * (c * q);
    Surface s;
    s.height = -(c * square) / (1.0f + 1.0f / q);
    s.slope_x = even * x;
    s.slope_y = even * y;
    s.curve_xx = even + more * x * x;
    s.curve_xy = more * x * y;
    s.curve_yy = even + more * y * y;
    return s;
}

/* The part's shape without relief. */
DEVICE Surface shape_at(Geometry g, REAL x, REAL y) {
    if (g.spherical > 0.0f) {
        return sphere(x, y, g.curvature_x);
    }
    return crown(x, y, g.curvature_x, g.curvature_y);
}

/* Where in a pixel a ray passes: at the same place of all, but for slices along a groove of its own. */
#ifdef SLICED
#define WITHIN REAL
#else
#define WITHIN float
#endif

/* Distance in mm from a station point, split into whole pixels and a fraction, to a sub-ray
   of pixel `index`: exact to a float's last bit wherever on the part it is. */
DEVICE REAL offset_mm(REAL index, WITHIN sub, float whole, float fraction, float sampling) {
    return ((index - whole) + (sub - fraction)) * sampling;
}

/* Nearest point of a centre line: vector from it, squared length, direction of the line there
   (zero at a rounded end, where there is none). */
STRUCT(Nearest) {
    REAL square;
    REAL away_x;
    REAL away_y;
    REAL along_x;
    REAL along_y;
};

/* Nearest point of one straight piece; (dx, dy) leads from its start to the ray. */
DEVICE Nearest nearest_point(REAL dx, REAL dy, Groove piece) {
    REAL share = (dx * piece.along_x + dy * piece.along_y) * piece.inverse_square;
    REAL foot = clamp(share, 0.0f, 1.0f);
    REAL unit = (share == foot ? piece.inverse_length : 0.0f);
    Nearest n;
    n.away_x = dx - foot * piece.along_x;
    n.away_y = dy - foot * piece.along_y;
    n.square = n.away_x * n.away_x + n.away_y * n.away_y;
    n.along_x = unit * piece.along_x;
    n.along_y = unit * piece.along_y;
    return n;
}

DEVICE Nearest nearer(Nearest a, Nearest b) {
    MASK second = b.square < a.square;
    a.away_x = second ? b.away_x : a.away_x;
    a.away_y = second ? b.away_y : a.away_y;
    a.along_x = second ? b.along_x : a.along_x;
    a.along_y = second ? b.along_y : a.along_y;
    a.square = second ? b.square : a.square;
    return a;
}

/* Gaussian groove z = d exp(-r^2 / 2 sigma^2), r the distance to its centre line: the relief of
   dent, bump and scratch. With v = r grad r: grad z = -z v / sigma^2,
   hess z = z (v v^T / sigma^4 - (1 - u u^T) / sigma^2), u the line's direction (0 at its ends). */
DEVICE Surface gaussian_groove(Nearest n, float depth, float inverse_variance) {
    REAL z = depth * exp(-0.5f * inverse_variance * n.square);
    REAL k = z * inverse_variance;
    REAL kk = k * inverse_variance;
    Surface s;
    s.height = z;
    s.slope_x = -k * n.away_x;
    s.slope_y = -k * n.away_y;
    s.curve_xx = kk * n.away_x * n.away_x - k * (1.0f - n.along_x * n.along_x);
    s.curve_xy = kk * n.away_x * n.away_y + k * n.along_x * n.along_y;
    s.curve_yy = kk * n.away_y * n.away_y - k * (1.0f - n.along_y * n.along_y);
    return s;
}

/* Whether the point (dx, dy) from the middle of an edge defect is in its ellipse: u^2 + v^2 < 1, u
   along the edge in halves of its width, v across in its depth. */
DEVICE MASK in_ellipse(REAL dx, REAL dy, Groove edge) {
    REAL u = (dx * edge.along_x + dy * edge.along_y) * edge.inverse_square;
    REAL off_x = dx - u * edge.along_x;
    REAL off_y = dy - u * edge.along_y;
    return u * u + (off_x * off_x + off_y * off_y) * edge.inverse_variance < 1.0f;
}

/* Weights of four neighbouring coefficients in a cubic B-spline, and in its derivatives;
   u in [0, 1) from the second of the four. Second derivatives are continuous, so slopes of a
   measured map are smooth. M. Unser, IEEE Signal Processing Magazine 16(6), 1999. */
STRUCT(Spline) {
    REAL w0;
    REAL w1;
    REAL w2;
    REAL w3;
};

DEVICE Spline spline_value(REAL u) {
    REAL v = 1.0f - u;
    Spline s;
    s.w0 = v * v * v / 6.0f;
    s.w1 = 2.0f / 3.0f - 0.5f * u * u * (1.0f + v);
    s.w2 = 2.0f / 3.0f - 0.5f * v * v * (1.0f + u);
    s.w3 = u * u * u / 6.0f;
    return s;
}

DEVICE Spline spline_slope(REAL u) {
    REAL v = 1.0f - u;
    Spline s;
    s.w0 = -0.5f * v * v;
    s.w1 = u * (1.5f * u - 2.0f);
    s.w2 = v * (2.0f - 1.5f * v);
    s.w3 = 0.5f * u * u;
    return s;
}

DEVICE Spline spline_curve(REAL u) {
    Spline s;
    s.w0 = 1.0f - u;
    s.w1 = 3.0f * u - 2.0f;
    s.w2 = 1.0f - 3.0f * u;
    s.w3 = u;
    return s;
}

DEVICE REAL spline_sum(Spline s, REAL c0, REAL c1, REAL c2, REAL c3) {
    return s.w0 * c0 + s.w1 * c1 + s.w2 * c2 + s.w3 * c3;
}

#endif
