/* What a footprint sees of the stripes: the lit fraction, and its mean over a scan. */
#ifndef STRIPES_H
#define STRIPES_H

/* The lit fraction as a function of the shift is a periodic trapezoid, for any footprint w:
   q = (n a + clamp(e - d, lo, hi)) / w with n = floor(w/P), w' = w - n P, e = (a + w')/2,
   hi = min(a, w'), lo = max(0, a + w' - P) and d the distance of l - s from the nearest point of
   a/2 + n P/2 + P Z. */
STRUCT(Trapezoid) {
    REAL centre;    /* (l - a/2 - n P/2) / P, in periods */
    REAL reach;     /* e */
    REAL low;       /* lo */
    REAL high;      /* hi */
    REAL whole;     /* n a */
    REAL footprint; /* w */
};

DEVICE Trapezoid trapezoid(REAL light, REAL footprint, float luminous, float period) {
    REAL n = floor(footprint / period);
    REAL rest = footprint - n * period;
    Trapezoid t;
    t.centre = (light - 0.5f * luminous) / period - 0.5f * n;
    t.centre -= floor(t.centre);
    t.reach = 0.5f * (luminous + rest);
    t.low = fmax(luminous + rest - period, 0.0f);
    t.high = fmin(rest, luminous);
    t.whole = n * luminous;
    t.footprint = footprint;
    return t;
}

/* Lit fraction q at a shift, given in periods. */
DEVICE REAL lit_fraction(Trapezoid t, float shift, float period) {
    REAL u = t.centre - shift;
    REAL d = fabs(u - rint(u)) * period;
    return (t.whole + clamp(t.reach - d, t.low, t.high)) / t.footprint;
}

/* Signal over saturation, before the sensor clips: E = g rho V (beta + (1 - beta) q). */
DEVICE REAL exposure(REAL lit, REAL irradiance, float gain, float leak) {
    return gain * irradiance * (leak + (1.0f - leak) * lit);
}

/* Mean over one whole period in K equal steps D = P/K of min(offset + slope q, 1).
   Each side of the trapezoid is sampled at distances D (j + o), o = phi and 1 - phi, phi the
   phase of the nearest step: n1 samples lie on the plateau, n0 - n1 on the flank, an arithmetic
   series. With h = min(hi, w q_sat - n a), k = min(lo, h):
   T = K k + sum_o [n1 (h - k) + m (e - k) - D (m o + (n0 (n0 - 1) - n1 (n1 - 1))/2)].
   The cost does not depend on K. */
DEVICE REAL series_side(REAL o, REAL e, REAL h, REAL k, float step) {
    REAL n1 = fmax(floor((e - h) / step - o) + 1.0f, 0.0f);
    REAL n0 = fmax(floor((e - k) / step - o) + 1.0f, 0.0f);
    REAL m = n0 - n1;
    return n1 * (h - k) + m * (e - k) - step * m * (o + 0.5f * (n0 + n1 - 1.0f));
}

DEVICE REAL mean_over_scan(REAL light, REAL footprint, REAL irradiance, float luminous,
                           float period, float images, float gain, float leak) {
    Trapezoid t = trapezoid(light, footprint, luminous, period);
    float step = period / images;
    REAL offset = gain * leak * irradiance;
    REAL slope = gain * (1.0f - leak) * irradiance;
    REAL h = fmin((1.0f - offset) / fmax(slope, 1e-20f) * footprint - t.whole, t.high);
    REAL k = fmin(t.low, h);
    REAL phase = t.centre * images;
    phase -= floor(phase);
    REAL total = images * k + series_side(phase, t.reach, h, k, step)
                 + series_side(1.0f - phase, t.reach, h, k, step);
    return offset + slope * (t.whole + total / images) / footprint;
}

#endif
