/* From a pixel to the light: camera ray, law of reflection, tunnel, footprint. */
#ifndef REFLECTION_H
#define REFLECTION_H

#ifdef SLICED
#include "slices.h"
#endif

/* Smallest footprint on the light, in mm: a point-sampled pixel, kept finite. */
#define FOOTPRINT_MIN 1e-4f

STRUCT(Vector) {
    REAL x;
    REAL y;
    REAL z;
};

DEVICE Vector vector(REAL x, REAL y, REAL z) {
    Vector v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}

DEVICE REAL inner(Vector a, Vector b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* a + k b */
DEVICE Vector along(Vector a, REAL k, Vector b) {
    return vector(a.x + k * b.x, a.y + k * b.y, a.z + k * b.z);
}

DEVICE Vector scaled(REAL k, Vector a) {
    return vector(k * a.x, k * a.y, k * a.z);
}

#ifdef POSED

/* A vector of the part's frame in the tunnel's. */
DEVICE Vector turned(Geometry g, Vector v) {
    return vector(g.pose_xx * v.x + g.pose_xy * v.y + g.pose_xz * v.z,
                  g.pose_yx * v.x + g.pose_yy * v.y + g.pose_yz * v.z,
                  g.pose_zx * v.x + g.pose_zy * v.y + g.pose_zz * v.z);
}

/* And back. */
DEVICE Vector turned_back(Geometry g, Vector v) {
    return vector(g.pose_xx * v.x + g.pose_yx * v.y + g.pose_zx * v.z,
                  g.pose_xy * v.x + g.pose_yy * v.y + g.pose_zy * v.z,
                  g.pose_xz * v.x + g.pose_yz * v.y + g.pose_zz * v.z);
}

#endif

/* Normal n = (-dz/dx, -dz/dy, 1), not a unit vector. */
DEVICE Vector surface_normal(Surface s) {
    return vector(-s.slope_x, -s.slope_y, 1.0f);
}

/* One Newton step for the height z at which the ray through (x0, y0, 0) meets the surface:
   the ray passes (x0 k, y0 k, z), k = 1 - z/h. */
DEVICE REAL newton_height(REAL z, Surface s, REAL x0, REAL y0, float h) {
    float inverse = 1.0f / h;
    return z - (z - s.height) / (1.0f + (s.slope_x * x0 + s.slope_y * y0) * inverse);
}

/* Where a ray from `origin` meets the tunnel: its path t, in lengths of `ray`, and the tunnel's normal
   there, (0, T_y, T_z): it is the same all along x. */
STRUCT(Hit) {
    REAL path;
    Vector normal;
};

/* Ceiling: the plane z = H. */
DEVICE Hit hit_ceiling(Vector origin, Vector ray, float height) {
    Hit hit;
    hit.path = (height - origin.z) / max(ray.z, 1e-6f);
    hit.normal = vector(0.0f, 0.0f, 1.0f);
    return hit;
}

/* Box: the ceiling and the walls y = +-w, whichever comes first. */
DEVICE Hit hit_box(Vector origin, Vector ray, float height, float half_width) {
    Hit hit = hit_ceiling(origin, ray, height);
    REAL side = (ray.y < 0.0f ? -1.0f : 1.0f);
    REAL wall = (half_width - side * origin.y) / max(side * ray.y, 1e-9f);
    MASK first = wall < hit.path;
    hit.path = min(wall, hit.path);
    hit.normal.y = first ? side : hit.normal.y;
    hit.normal.z = first ? 0.0f : hit.normal.z;
    return hit;
}

/* Arch: the half cylinder y^2 + z^2 = radius^2. */
DEVICE Hit hit_arch(Vector origin, Vector ray, float radius) {
    REAL a = max(ray.y * ray.y + ray.z * ray.z, 1e-12f);
    REAL b = origin.y * ray.y + origin.z * ray.z;
    REAL c = origin.y * origin.y + origin.z * origin.z - radius * radius;
    Hit hit;
    hit.path = (sqrt(max(b * b - a * c, 0.0f)) - b) / a;
    hit.normal = vector(0.0f, (origin.y + hit.path * ray.y) / radius,
                        (origin.z + hit.path * ray.z) / radius);
    return hit;
}

DEVICE Hit hit_tunnel(Vector origin, Vector ray, Geometry g) {
    if (g.section == SECTION_ARCH) {
        return hit_arch(origin, ray, g.tunnel_top);
    }
    if (g.section == SECTION_BOX) {
        return hit_box(origin, ray, g.tunnel_top, g.tunnel_half_width);
    }
    return hit_ceiling(origin, ray, g.tunnel_top);
}

/* Fresnel reflectance of unpolarised light on a medium n - ik, at the cosine of the angle of
   incidence. M. Born, E. Wolf, Principles of Optics, 14.2. */
DEVICE REAL fresnel_reflectance(REAL cosine, float n, float k) {
    REAL c2 = cosine * cosine;
    REAL s2 = 1.0f - c2;
    REAL t0 = (n * n - k * k) - s2;
    REAL modulus = sqrt(t0 * t0 + 4.0f * n * n * k * k);
    REAL t1 = modulus + c2;
    REAL t2 = 2.0f * cosine * sqrt(max(0.5f * (modulus + t0), 0.0f));
    REAL rs = (t1 - t2) / (t1 + t2);
    REAL t3 = c2 * modulus + s2 * s2;
    REAL t4 = t2 * s2;
    return 0.5f * rs * (1.0f + (t3 - t4) / (t3 + t4));
}

/* A camera ray that meets the part. No vector here has length 1: a law of reflection asks for none,
   and roots and divisions are what a pixel costs. */
STRUCT(CameraRay) {
    Vector point;     /* S, where it meets the surface */
    Vector direction; /* I = (x0, y0, -h)/h, through (x0, y0, 0) from the pinhole O = (0, 0, h) */
    REAL share;       /* k = 1 - z/h: S - O = k h I */
#ifdef SLICED
    Slice slice;      /* what of its pixel it stands for */
#endif
};

/* Camera ray through (x0, y0, 0) to the height z: S = (x0 k, y0 k, z). */
DEVICE CameraRay camera_ray(REAL x0, REAL y0, REAL z, float h) {
    float inverse = 1.0f / h;
    CameraRay c;
    c.share = 1.0f - z * inverse;
    c.point = vector(x0 * c.share, y0 * c.share, z);
    c.direction = vector(x0 * inverse, y0 * inverse, -1.0f);
    return c;
}

#ifdef POSED

/* A posed camera's ray through the point (u, v) of its plane in focus, in the part's frame. */
STRUCT(Aim) {
    Vector away;      /* from (u, v, 0) of the part to that point Q, small where the pose is */
    Vector direction; /* I, by the camera's distance h as long as from the pupil to Q */
};

DEVICE Aim aim_at(Geometry g, REAL u, REAL v) {
    float inverse = 1.0f / g.camera_height;
    Aim aim;
    aim.away = vector(g.view_xx * u + g.view_xy * v + g.view_x,
                      g.view_yx * u + g.view_yy * v + g.view_y,
                      g.view_zx * u + g.view_zy * v + g.view_z);
    aim.direction = vector((u + g.view_xx * u + g.view_xy * v) * inverse - g.view_xz,
                           (v + g.view_yx * u + g.view_yy * v) * inverse - g.view_yz,
                           (g.view_zx * u + g.view_zy * v) * inverse - g.view_zz);
    return aim;
}

/* That ray at S = Q + way I. */
DEVICE CameraRay posed_ray(Geometry g, Aim aim, REAL u, REAL v, REAL way) {
    CameraRay c;
    c.share = 1.0f + way * (1.0f / g.camera_height);
    c.point = along(vector(u + aim.away.x, v + aim.away.y, aim.away.z), way, aim.direction);
    c.direction = aim.direction;
    return c;
}

#endif

/* The part as a mirror at a point. */
STRUCT(Mirror) {
    Vector normal;       /* n = (-dz/dx, -dz/dy, 1) */
    REAL inverse_square; /* 1/(n.n) */
    REAL facing;         /* I.n */
    REAL twice;          /* 2 (I.n)/(n.n) */
    Vector ray;          /* R, what it makes of the camera ray, as long as I */
};

/* Law of reflection at the surface: R = I - 2 (I.n)/(n.n) n. */
DEVICE Mirror mirror_of(CameraRay c, Surface s) {
    Mirror m;
    m.normal = surface_normal(s);
    m.inverse_square = 1.0f / inner(m.normal, m.normal);
    m.facing = inner(c.direction, m.normal);
    m.twice = 2.0f * m.facing * m.inverse_square;
    m.ray = along(c.direction, -m.twice, m.normal);
    return m;
}

/* Slopes of a quantity over the plane z = 0, where the camera ray passes it; `turn` is what of them
   is the ray's turning about its point of the part alone. */
STRUCT(Gradient) {
    REAL x;
    REAL y;
    REAL turn_x;
    REAL turn_y;
};

/* Gradient of the light coordinate l = L_x, L = S + t R. As the camera ray's point on z = 0 moves by e
   (H. Igehy, Tracing ray differentials, SIGGRAPH 1999, eqs. 10 to 14, for vectors of any length):
     dl = q.(dS + t dR), q = (1, 0, 0) - R_x/(T.R) T, for L keeps to the tunnel, T.dL = 0;
     dR = dI - 2 (I.n)/(n.n) dn - 2 (n.dI + R.dn)/(n.n) n, dI = e/h, dn = -(Hessian of z) dS;
     dS = k (e - (n.e)/(n.I) I) on a height surface, for n.dS = 0, and k e on z = 0.
   Summed from the left, from q on, dl = (gradient).e has both slopes at once. Of a posed camera e lies
   in its plane in focus, and what keeps to the part's z = 0 is dS = k (e - e_z/I_z I). */
DEVICE Gradient light_gradient(Geometry g, Surface s, CameraRay c, Mirror m, Hit hit) {
#ifdef POSED
    Vector ray = turned(g, m.ray);
#else
    Vector ray = m.ray;
#endif
    REAL slide = ray.x * (1.0f / max(inner(hit.normal, ray), 1e-6f));
    Vector q = vector(1.0f, -slide * hit.normal.y, -slide * hit.normal.z);
#ifdef POSED
    q = turned_back(g, q);
#endif
    REAL turn = 2.0f * m.inverse_square * inner(q, m.normal);
    REAL tilt_x = hit.path * (m.twice * q.x + turn * m.ray.x);
    REAL tilt_y = hit.path * (m.twice * q.y + turn * m.ray.y);
    REAL swing = hit.path * (1.0f / g.camera_height);
    Gradient d;
    d.turn_x = swing * (q.x - turn * m.normal.x);
    d.turn_y = swing * (q.y - turn * m.normal.y);
#ifdef POSED
    REAL turn_z = swing * (q.z - turn * m.normal.z);
#endif
    q.x += s.curve_xx * tilt_x + s.curve_xy * tilt_y;
    q.y += s.curve_xy * tilt_x + s.curve_yy * tilt_y;
    if (g.rises > 0.0f) {
        q = along(q, -inner(q, c.direction) / m.facing, m.normal);
    }
    d.x = d.turn_x + c.share * q.x;
    d.y = d.turn_y + c.share * q.y;
#ifdef POSED
    if (g.rises == 0.0f) {
        q.z -= inner(q, c.direction) / c.direction.z;
    }
    REAL z = turn_z + c.share * q.z;
    REAL x = d.x;
    d.x += g.view_xx * d.x + g.view_yx * d.y + g.view_zx * z;
    d.y += g.view_xy * x + g.view_yy * d.y + g.view_zy * z;
    REAL turn_x = d.turn_x;
    d.turn_x += g.view_xx * turn_x + g.view_yx * d.turn_y + g.view_zx * turn_z;
    d.turn_y += g.view_xy * turn_x + g.view_yy * d.turn_y + g.view_zy * turn_z;
#endif
    return d;
}

/* What a pixel averages on the light: a box of width `wide` folded with one of width `narrow`. */
STRUCT(Footprint) {
    REAL wide;
    REAL narrow;
};

/* The two boxes w1 >= w2 whose variance and fourth cumulant are those of four kernels folded: boxes
   of the changes of l over a sub-ray's square along columns and along rows, p and q their squares;
   the pupil, a disc seen edge-on of radius r = D t/(2|S - O|); the roughness, a Gaussian of
   s = 2 alpha t. With u = 3 r^2 and v = 12 s^2, w1^2 + w2^2 = p + q + u + v and
   2 w1^2 w2^2 = 2 (pq + (p + q)(u + v) + uv) + u^2/6 + v^2, the latter at most half the former's
   square: w1 = w2. For the square alone it is exact. */
DEVICE Footprint two_boxes(REAL p, REAL q, REAL u, REAL v) {
    REAL sum = p + q + u + v;
    REAL product = 2.0f * (p * q + (p + q) * (u + v) + u * v) + u * u / 6.0f + v * v;
    REAL root = sqrt(max(sum * sum - 2.0f * product, 0.0f));
    REAL larger = 0.5f * (sum + root);
    REAL smaller = min(0.5f * product / max(larger, 1e-20f), larger);
    Footprint w;
    w.wide = max(sqrt(larger), FOOTPRINT_MIN);
    w.narrow = sqrt(smaller);
    return w;
}

/* The square u = 3 r^2 of the pupil's image on the light, a disc seen edge-on, where the camera is
   focused at the distance F. The ray from a point a of the pupil passes z = 0 at a (1 - h/F) from
   where that of the pupil's centre does, and is turned by -a/F. Of l that makes
   a.[(1/k - h/F) gradient - turn/k], of radius r = D/2 times the length of that vector: the part is
   blurred, while of a light at F + t the pupil sees a point. */
DEVICE REAL defocused_square(Geometry g, Gradient d, REAL share) {
    REAL inverse = 1.0f / share;
    REAL off = inverse - g.camera_height / g.focus;
    REAL x = off * d.x - inverse * d.turn_x;
    REAL y = off * d.y - inverse * d.turn_y;
    return 0.75f * g.pupil * g.pupil * (x * x + y * y);
}

/* How much further a sub-ray at t pixels from its pixel's centre is where that looks at a spot: spread
   so that all have the spot's variance and fourth cumulant. */
DEVICE float spot_offset(Geometry g, float t) {
    return t * (g.widening + g.warp * t * t);
}

/* Square of what a pixel sees that looks at a spot: of a square of side p, a lens's Gaussian b, and the
   pupil's disc. */
DEVICE REAL spot_square(Geometry g, Gradient d, REAL disc) {
    return (g.sampling * g.sampling + 12.0f * g.blur * g.blur) * (d.x * d.x + d.y * d.y) + disc;
}

/* How much sub-rays are turned as the pupil's points that look there are on average, for each mm from the
   pixel's centre; `square` is that of all a pixel sees. Where the spot's own variance is little beside it, the
   pupil is nearly all there is to see, and the less a place tells of its point the less it is a
   sum of turned discs: those are narrower, and have too small a fourth cumulant. */
DEVICE REAL lean_of(Geometry g, Gradient d, REAL share, REAL square) {
    REAL own = g.spot * g.spot * (d.x * d.x + d.y * d.y);
    REAL one = 1.0f;
    return g.lean / share * (g.least_lean + (one - g.least_lean) * min(own / square, one));
}

/* Footprint where a pixel looks at a spot. Its sub-rays have the spot's variance, that of a square of side
   `spot`, each of them turned by -lean its distance. What that leaves out of the variance is one's own
   disc. */
DEVICE Footprint spot_footprint(Geometry g, Gradient d, REAL share, REAL disc, REAL gauss) {
    if (g.focus > 0.0f) {
        disc = defocused_square(g, d, share);
    }
    float p = g.sampling;
    REAL across = p * d.x;
    REAL down = p * d.y;
    if (g.subsampling > 1.0f) {
        REAL square = spot_square(g, d, disc);
        REAL lean = lean_of(g, d, share, square);
        across = g.spot * (d.x - lean * d.turn_x);
        down = g.spot * (d.y - lean * d.turn_y);
        float part = 1.0f / (g.subsampling * g.subsampling);
        REAL x = across * across;
        REAL y = down * down;
        return two_boxes(part * x, part * y, max(square - (x + y), 0.0f), gauss);
    }
    REAL lens = 12.0f * g.blur * g.blur * (d.x * d.x + d.y * d.y);
    return two_boxes(across * across, down * down, disc, gauss + lens);
}

/* Footprint on the light of a sub-ray's square, the pupil and the roughness. */
DEVICE Footprint footprint_under(Geometry g, Gradient slope, CameraRay c, Mirror m, Hit hit) {
#ifdef SLICED
    REAL across = g.sampling * (c.slice.across_x * slope.x + c.slice.across_y * slope.y);
    REAL down = g.sampling * (c.slice.along_x * slope.x + c.slice.along_y * slope.y);
#else
    float p = g.sampling / g.subsampling;
    REAL across = p * slope.x;
    REAL down = p * slope.y;
#endif
    float diameter = 0.8660254f * g.pupil / g.camera_height;
    REAL pupil = diameter * hit.path / c.share;
#ifdef POSED
    /* Exact, where the light is met as obliquely as a tilt makes it. */
    REAL swing = sqrt(slope.turn_x * slope.turn_x + slope.turn_y * slope.turn_y);
    pupil = diameter * g.camera_height * swing / c.share;
#endif
    REAL rough = 0.0f;
    if (g.roughness > 0.0f) {
        rough = 6.9282032f * g.roughness * hit.path * sqrt(inner(m.ray, m.ray));
    }
#ifndef SLICED
    if (g.blur > 0.0f || g.focus > 0.0f) {
        return spot_footprint(g, slope, c.share, pupil * pupil, rough * rough);
    }
#endif
    return two_boxes(across * across, down * down, pupil * pupil, rough * rough);
}

/* The same at a point of the part. */
DEVICE Footprint footprint_of(Geometry g, Surface s, CameraRay c, Mirror m, Hit hit) {
    return footprint_under(g, light_gradient(g, s, c, m, hit), c, m, hit);
}

/* Why the ray to the light point sees no light: the first that holds of beside the part, reflected
   down, past the tunnel's end, in the camera's opening (a rectangle in the tunnel's top). At a point
   that an edge defect decides, `outline` says: 1 of the part, in a burr, -1 beside it, in a chip. */
DEVICE REAL loss_of(Geometry g, CameraRay c, Mirror m, Hit hit, Vector light, REAL outline) {
    MASK opening = fabs(light.x) <= g.opening_half_length && fabs(light.y) <= g.opening_half_width
                   && hit.normal.z > 0.0f && g.opening_half_length > 0.0f;
    REAL lost = (opening ? LOST_OPENING : LOST_NOT);
    lost = (fabs(light.x) > g.tunnel_half_length ? LOST_END : lost);
    lost = (m.ray.z <= 0.0f ? LOST_DOWN : lost);
    MASK beside = fabs(c.point.x) > g.half_length || fabs(c.point.y) > g.half_width;
    beside = (beside && outline <= 0.0f) || outline < 0.0f;
    return (beside ? LOST_BESIDE : lost);
}

/* Of a pixel's sub-rays, one after another: it is seen if any is, else lost for the largest reason.
   Begins with LOST_BESIDE, the least. */
DEVICE REAL loss_of_both(REAL a, REAL b) {
    return (min(a, b) == LOST_NOT ? LOST_NOT : max(a, b));
}

/* Relative irradiance on the sensor: the mirror's reflectance, and cos^4 of the field angle where
   the camera has vignetting. */
DEVICE REAL irradiance_of(Geometry g, CameraRay c, Mirror m) {
    REAL irradiance = 1.0f;
    REAL square = inner(c.direction, c.direction);
    if (g.vignetting > 0.0f) {
        irradiance = 1.0f / (square * square);
    }
    if (g.refractive_index > 0.0f || g.extinction > 0.0f) {
        REAL cosine = fabs(m.facing) * sqrt(m.inverse_square / square);
        irradiance *= fresnel_reflectance(cosine, g.refractive_index, g.extinction);
    }
    return irradiance;
}

/* What one ray knows of the light: the light map's entry. */
STRUCT(Sight) {
    REAL light;      /* light coordinate l, mm */
    REAL across;     /* the light point's other coordinate, L_y, mm */
    REAL wide;       /* widths of the two boxes on the light, mm */
    REAL narrow;
    REAL irradiance; /* relative: reflectance x vignetting, 0 where lost */
    REAL lost;       /* LOST_... */
};

#ifdef POSED
/* One ray whole, over the surface `s` of a posed part: reflected in the part's frame, it meets the
   tunnel in the tunnel's. `again` is where it meets the part first, `hidden` where another piece of the
   part is before its point; the rest as of `sight_from`. */
DEVICE Sight posed_sight(Geometry g, Surface s, CameraRay c, float x, float y, REAL outline,
                         MASK hidden, MASK again) {
#elif defined(SLICED)
/* One ray whole of a slice of a pixel, from the camera over the surface `s` to the light. */
DEVICE Sight slice_sight(Geometry g, Surface s, CameraRay c, REAL outline) {
#else
/* One ray whole, from the camera over the surface `s` at height z to the light; (x, y) is how far on
   z = 0 it is from its pixel's centre, where the camera is off focus; `outline` as in `loss_of`. */
DEVICE Sight sight_from(Geometry g, Surface s, REAL x0, REAL y0, REAL z, float x, float y,
                        REAL outline) {
    CameraRay c = camera_ray(x0, y0, z, g.camera_height);
#endif
    Mirror m = mirror_of(c, s);
    Mirror leaving = m;
    Vector from = c.point;
#ifdef POSED
    leaving.ray = turned(g, m.ray);
    from = along(vector(g.pose_x, g.pose_y, g.pose_z), 1.0f, turned(g, c.point));
#endif
    Hit hit = hit_tunnel(from, leaving.ray, g);
    Vector light = along(from, hit.path, leaving.ray);
    Gradient slope = light_gradient(g, s, c, m, hit);
    Footprint footprint = footprint_under(g, slope, c, m, hit);
    REAL irradiance = irradiance_of(g, c, m);
#ifdef SLICED
    irradiance *= c.slice.share;
#else
    if (g.lean != 0.0f) {
        REAL square = spot_square(g, slope, defocused_square(g, slope, c.share));
        light.x -= lean_of(g, slope, c.share, square) * (x * slope.turn_x + y * slope.turn_y);
    }
#endif
    Sight v;
    v.lost = loss_of(g, c, leaving, hit, light, outline);
#ifdef POSED
    /* What is behind the camera is beside the part. */
    v.lost = (c.share <= 0.0f ? LOST_BESIDE : v.lost);
    v.lost = (again && v.lost != LOST_BESIDE && v.lost != LOST_DOWN ? LOST_AGAIN : v.lost);
    v.lost = ((hidden || m.facing >= 0.0f) && v.lost != LOST_BESIDE ? LOST_HIDDEN : v.lost);
#endif
    MASK lit = v.lost == LOST_NOT;
    v.light = (lit ? light.x : 0.0f);
    v.across = light.y;
    v.wide = (lit ? footprint.wide : 1.0f);
    v.narrow = (lit ? footprint.narrow : 0.0f);
    v.irradiance = (lit ? irradiance : 0.0f);
    return v;
}

#if !defined(POSED) && !defined(SLICED)
/* The same of a pixel's centre. */
DEVICE Sight sight(Geometry g, Surface s, REAL x0, REAL y0, REAL z, REAL outline) {
    return sight_from(g, s, x0, y0, z, 0.0f, 0.0f, outline);
}
#endif

#endif
