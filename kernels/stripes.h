/* What a footprint sees of the stripes: the lit fraction, its exposure, and their mean over a
   scan. Lengths on the light are in periods P of the stripes here. */
#ifndef STRIPES_H
#define STRIPES_H

/* As a function of the shift s, what a footprint sees is a periodic trapezoid,
   base + slope clamp(reach - d, low, high), d the distance of l - s from the nearest `centre`. */
STRUCT(Trapezoid) {
    REAL centre;
    REAL reach;
    REAL low;
    REAL high;
    REAL base;
    REAL slope;
};

/* Lit fraction q of a footprint w at l: the share of [l - w/2, l + w/2] on luminous stripes of
   width a. With n = floor(w), w' = w - n: q = (n a + clamp(e - d, lo, hi)) / w,
   e = (a + w')/2, hi = min(a, w'), lo = max(0, a + w' - 1), centres at a/2 + n/2 + Z. */
DEVICE Trapezoid lit_fraction(REAL light, REAL footprint, float luminous) {
    REAL n = floor(footprint);
    REAL rest = footprint - n;
    REAL centre = (light - 0.5f * luminous) - 0.5f * n;
    Trapezoid q;
    q.centre = centre - floor(centre);
    q.reach = 0.5f * (luminous + rest);
    q.low = max(luminous + rest - 1.0f, 0.0f);
    q.high = min(rest, luminous);
    q.slope = 1.0f / footprint;
    q.base = n * luminous * q.slope;
    return q;
}

/* Signal over saturation before the sensor clips, E = g rho V (beta + (1 - beta) q): affine in q,
   hence a trapezoid too. */
DEVICE Trapezoid exposed(Trapezoid q, REAL irradiance, float gain, float leak) {
    REAL full = gain * irradiance;
    q.slope *= full * (1.0f - leak);
    q.base = full * (leak + (1.0f - leak) * q.base);
    return q;
}

/* A trapezoid's value when the light is shifted by `shift` periods. */
DEVICE REAL at_shift(Trapezoid t, float shift) {
    REAL u = t.centre - shift;
    REAL d = fabs(u - rint(u));
    return t.base + t.slope * min(max(t.reach - d, t.low), t.high);
}

/* One side of the trapezoid, sampled at distances j + o, j = 0, 1 ..., lengths in steps: n1 samples
   lie on the plateau h, the next m = n0 - n1 on the flank: an arithmetic series above k. */
DEVICE REAL series_side(REAL o, REAL reach, REAL h, REAL k) {
    REAL n1 = max(floor(reach - h - o) + 1.0f, 0.0f);
    REAL n0 = max(floor(reach - k - o) + 1.0f, 0.0f);
    REAL m = n0 - n1;
    return n1 * (h - k) + m * ((reach - k) - o - 0.5f * (n0 + n1 - 1.0f));
}

/* Mean of min(E, 1) over whole periods in equal steps, `shifts` of them a period. Where E
   saturates the trapezoid is cut at h = min(high, (1 - base)/slope), k = min(low, h); the sum over
   the shifts is T = K k + both sides' series. The cost does not depend on the shifts' number. */
DEVICE REAL mean_over_scan(Trapezoid t, float shifts) {
    REAL h = min((1.0f - t.base) / max(t.slope, 1e-20f), t.high);
    REAL k = min(t.low, h);
    REAL phase = t.centre * shifts;
    phase -= floor(phase);
    REAL total = shifts * (shifts * k)
                 + series_side(phase, t.reach * shifts, h * shifts, k * shifts)
                 + series_side(1.0f - phase, t.reach * shifts, h * shifts, k * shifts);
    return min(t.base + t.slope * total / (shifts * shifts), 1.0f);
}

/* Highest mean over a scan that any light coordinate has, or a little more. As the phase moves the
   mean is made of straight pieces; it can only be highest where it bends down, when a sample comes
   to the edge of the plateau h: on either side, by symmetry. The trapezoid is made wider by more
   than float32 may put that edge out. */
DEVICE REAL highest_mean_over_scan(Trapezoid t, float shifts) {
    t.centre = t.reach - min((1.0f - t.base) / max(t.slope, 1e-20f), t.high);
    t.reach += 1e-6f;
    return mean_over_scan(t, shifts);
}

#endif
