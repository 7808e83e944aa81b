/* From a pixel to the light: camera ray, law of reflection, tunnel, footprint. */
#ifndef REFLECTION_H
#define REFLECTION_H

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

/* Unit vector n/|n| and, for a change dn, its change (dn - N (N.dn)) / |n|. */
DEVICE Vector unit_change(Vector unit, REAL size, Vector change) {
    return scaled(1.0f / size, along(change, -inner(unit, change), unit));
}

/* Normal N = (-dz/dx, -dz/dy, 1), not yet a unit vector. */
DEVICE Vector surface_normal(Surface s) {
    return vector(-s.slope_x, -s.slope_y, 1.0f);
}

/* Law of reflection R = I - 2 (I.N) N. */
DEVICE Vector reflect_direction(Vector incident, Vector normal) {
    return along(incident, -2.0f * inner(incident, normal), normal);
}

/* Its change: dR = dI - 2 [(I.N) dN + (dI.N + I.dN) N].
   H. Igehy, Tracing ray differentials, SIGGRAPH 1999, eq. 14. */
DEVICE Vector reflect_change(Vector incident, Vector normal, Vector d_incident, Vector d_normal) {
    Vector d = along(d_incident, -2.0f * inner(incident, normal), d_normal);
    return along(d, -2.0f * (inner(d_incident, normal) + inner(incident, d_normal)), normal);
}

/* One Newton step for the height z at which the ray through (x0, y0, 0) meets the surface:
   the ray passes (x0 k, y0 k, z), k = 1 - z/h. */
DEVICE REAL newton_height(REAL z, Surface s, REAL x0, REAL y0, float h) {
    return z - (z - s.height) / (1.0f + (s.slope_x * x0 + s.slope_y * y0) / h);
}

/* Change of the surface point when the ray's point on z = 0 moves by (dx, dy): on a height
   surface (`rises` = 1) it keeps to the surface, else (0) to z = 0. */
DEVICE Vector surface_change(Surface s, REAL x0, REAL y0, REAL z, float h, float dx, float dy,
                             float rises) {
    REAL k = 1.0f - z / h;
    REAL dz = rises * (s.slope_x * dx + s.slope_y * dy) * k
              / (1.0f + (s.slope_x * x0 + s.slope_y * y0) / h);
    return vector(k * dx - x0 * dz / h, k * dy - y0 * dz / h, dz);
}

/* Where a ray from `origin` meets the tunnel: path t and the tunnel's normal there. */
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
   incidence. M. Born, E. Wolf, Principles of Optics, 14.2; 1 where n = k = 0 (ideal mirror). */
DEVICE REAL fresnel_reflectance(REAL cosine, float n, float k) {
    if (n == 0.0f && k == 0.0f) {
        return 1.0f;
    }
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

/* A camera ray that meets the part. */
STRUCT(CameraRay) {
    REAL x0;          /* where it passes z = 0, mm */
    REAL y0;
    Vector point;     /* S, where it meets the surface */
    Vector direction; /* I = (S - O)/|S - O|, from the pinhole O = (0, 0, h) */
    REAL distance;    /* |S - O| */
};

/* Camera ray through (x0, y0, 0) to the height z: S = (x0 k, y0 k, z), k = 1 - z/h. */
DEVICE CameraRay camera_ray(REAL x0, REAL y0, REAL z, float h) {
    REAL k = 1.0f - z / h;
    CameraRay c;
    c.x0 = x0;
    c.y0 = y0;
    c.point = vector(x0 * k, y0 * k, z);
    Vector view = vector(c.point.x, c.point.y, z - h);
    c.distance = sqrt(inner(view, view));
    c.direction = scaled(1.0f / c.distance, view);
    return c;
}

/* The part as a mirror at a point. */
STRUCT(Mirror) {
    Vector normal; /* unit vector N = n/|n| of n = (-dz/dx, -dz/dy, 1) */
    REAL length;   /* |n| */
    Vector ray;    /* R, what it makes of the camera ray */
};

/* Law of reflection at the surface: R = I - 2 (I.N) N. */
DEVICE Mirror mirror_of(CameraRay c, Surface s) {
    Vector upright = surface_normal(s);
    Mirror m;
    m.length = sqrt(inner(upright, upright));
    m.normal = scaled(1.0f / m.length, upright);
    m.ray = reflect_direction(c.direction, m.normal);
    return m;
}

/* Change of the light coordinate l = L_x, L = S + t R, as the camera ray's point on z = 0 moves by
   (dx, dy): dL = dS + t dR + dt R stays in the tunnel's tangent plane, T.dL = 0.
   H. Igehy, Tracing ray differentials, SIGGRAPH 1999, eqs. 10 to 14. */
DEVICE REAL light_change(Geometry g, Surface s, CameraRay c, Mirror m, Hit hit, float dx,
                         float dy) {
    Vector dp = surface_change(s, c.x0, c.y0, c.point.z, g.camera_height, dx, dy, g.rises);
    Vector di = unit_change(c.direction, c.distance, dp);
    Vector dn = vector(-(s.curve_xx * dp.x + s.curve_xy * dp.y),
                       -(s.curve_xy * dp.x + s.curve_yy * dp.y), 0.0f);
    Vector dr = reflect_change(c.direction, m.normal, di, unit_change(m.normal, m.length, dn));
    Vector moved = along(dp, hit.path, dr);
    REAL facing = inner(hit.normal, m.ray);
    REAL dt = -inner(hit.normal, moved) / max(facing, 1e-6f);
    return moved.x + dt * m.ray.x;
}

/* Footprint w on the light: w^2 is the sum of the squares of four boxes, each of the variance of
   the true kernel: the changes of l over a sub-ray's square along columns and along rows, the
   pupil's sqrt(3)/2 D t/|S - O|, the roughness' sqrt(12) 2 alpha t. */
DEVICE REAL footprint_of(Geometry g, Surface s, CameraRay c, Mirror m, Hit hit) {
    float p = g.sampling / g.subsampling;
    REAL square = 0.0f;
    for (int axis = 0; axis < 2; axis++) {
        float dx = (axis == 0) ? p : 0.0f;
        REAL dl = light_change(g, s, c, m, hit, dx, p - dx);
        square += dl * dl;
    }
    REAL pupil = 0.8660254f * g.pupil * hit.path / c.distance;
    REAL rough = 6.9282032f * g.roughness * hit.path;
    return max(sqrt(square + pupil * pupil + rough * rough), FOOTPRINT_MIN);
}

/* Why the ray to the light point sees no light: the first that holds of beside the part, reflected
   down, past the tunnel's end, in the camera's opening (a rectangle in the tunnel's top). */
DEVICE REAL loss_of(Geometry g, CameraRay c, Mirror m, Hit hit, Vector light) {
    MASK opening = fabs(light.x) <= g.opening_half_length && fabs(light.y) <= g.opening_half_width
                   && hit.normal.z > 0.0f && g.opening_half_length > 0.0f;
    REAL lost = (opening ? LOST_OPENING : LOST_NOT);
    lost = (fabs(light.x) > g.tunnel_half_length ? LOST_END : lost);
    lost = (m.ray.z <= 0.0f ? LOST_DOWN : lost);
    MASK beside = fabs(c.point.x) > g.half_length || fabs(c.point.y) > g.half_width;
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
    float h = g.camera_height;
    REAL cosine = h / sqrt(c.x0 * c.x0 + c.y0 * c.y0 + h * h);
    REAL field = (g.vignetting > 0.0f) ? cosine * cosine * cosine * cosine : 1.0f;
    return field * fresnel_reflectance(fabs(inner(c.direction, m.normal)), g.refractive_index,
                                       g.extinction);
}

/* What one ray knows of the light: the light map's entry. */
STRUCT(Sight) {
    REAL light;      /* light coordinate l, mm */
    REAL across;     /* the light point's other coordinate, L_y, mm */
    REAL footprint;  /* width w of the box on the light, mm */
    REAL irradiance; /* relative: reflectance x vignetting, 0 where lost */
    REAL lost;       /* LOST_... */
};

/* One ray whole, from the camera over the surface `s` at height z to the light. */
DEVICE Sight sight(Geometry g, Surface s, REAL x0, REAL y0, REAL z) {
    CameraRay c = camera_ray(x0, y0, z, g.camera_height);
    Mirror m = mirror_of(c, s);
    Hit hit = hit_tunnel(c.point, m.ray, g);
    Vector light = along(c.point, hit.path, m.ray);
    REAL footprint = footprint_of(g, s, c, m, hit);
    REAL irradiance = irradiance_of(g, c, m);
    Sight v;
    v.lost = loss_of(g, c, m, hit, light);
    MASK lit = v.lost == LOST_NOT;
    v.light = (lit ? light.x : 0.0f);
    v.across = light.y;
    v.footprint = (lit ? footprint : 1.0f);
    v.irradiance = (lit ? irradiance : 0.0f);
    return v;
}

#endif
