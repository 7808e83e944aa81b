/* Noise in closed form: mean and variance of the noisy aspect image over all its draws, from the
   exposures of its images. What the sensor makes of one signal stands in a table of cells; the
   including program has a struct `Cells` with the number of the last in `last`, and fetches cell i by
   CELL(cells, i), i an integer as a REAL: two values, each with its rise. */
#ifndef NOISE_H
#define NOISE_H

/* Above every normal number: uniform numbers are not below 2^-24. */
#define NORMAL_MAX 5.77f

/* Mean and variance of a grey level, DN and DN^2, above those of noise that is neither clipped nor
   rounded: above black level + K mu_sat min(E, 1), and above K^2 (mu_sat E + sigma_d^2) + 1/12 for
   E < 1, else 0. */
STRUCT(Excess) {
    REAL mean;
    REAL variance;
};

/* Place of a signal among the cells: they are finest where noise may be less than a grey level, and
   one begins where the sensor saturates. */
DEVICE REAL place_of(REAL signal) {
    return min(signal * CELLS_FINE, signal * CELLS_COARSE + CELLS_OFFSET);
}

/* Whether a signal is in the cells from saturation on. */
DEVICE MASK saturates(REAL signal) {
    return place_of(signal) >= CELLS_COARSE + CELLS_OFFSET;
}

/* Excess at a place among the cells. */
DEVICE Excess cell_excess(Cells cells, REAL place) {
    place = clamp(place, 0.0f, cells.last);
    REAL begin = floor(place);
    REAL share = place - begin;
    Four cell = CELL(cells, begin);
    Excess e;
    e.mean = cell.a + share * cell.b;
    e.variance = cell.c + share * cell.d;
    return e;
}

/* A design's noise: what all its pixels share. */
STRUCT(Noise) {
    float dn;         /* grey levels per E: K mu_sat */
    float shot;       /* variance per E, in E^2 */
    float read;       /* in the dark */
    REAL spread;      /* standard deviation at saturation */
    REAL per_spread;
    float step;       /* 1 / shifts */
    float dark;       /* E without light, where pixels are alike */
    Excess in_dark;
};

/* None: of what is saturated in all its noise. */
DEVICE Excess no_excess() {
    Excess e;
    e.mean = 0.0f;
    e.variance = 0.0f;
    return e;
}

/* Excess at one signal: many pixels see no light, and need not fetch. */
DEVICE Excess excess_at(Cells cells, Noise n, REAL signal) {
    if (ANY(signal != n.dark)) {
        return cell_excess(cells, place_of(signal));
    }
    return n.in_dark;
}

DEVICE Noise noise_of(Design d, Cells cells) {
    REAL none = 0.0f;
    Noise n;
    n.dn = d.full_scale - d.black_level;
    n.shot = 1.0f / d.saturation;
    n.read = d.read_noise * d.read_noise * n.shot * n.shot;
    n.spread = sqrt(none + (n.shot + n.read));
    n.per_spread = 1.0f / n.spread;
    n.step = 1.0f / d.distinct_shifts;
    n.dark = d.dark_signal / d.saturation;
    n.in_dark = cell_excess(cells, place_of(none + n.dark));
    return n;
}

/* A step from 0 to 1, smooth, where x goes from 0 to 1. */
DEVICE REAL smooth_step(REAL x) {
    REAL u = clamp(x, 0.0f, 1.0f);
    return u * u * (3.0f - 2.0f * u);
}

/* By how much clipping lowers the mean of a normal number, in its standard deviations, beside what it
   takes from a number without spread: phi(t) - |t| (1 - Phi(|t|)), t from saturation; within 0.002. */
DEVICE REAL clipped_mean(REAL t) {
    REAL u = max(1.0f - 0.31984f * fabs(t), 0.0f);
    u *= u;
    return 0.3976f * u * u;
}

/* Integral of clipped_mean from minus infinity to t, 1/2 in all; within 0.02. */
DEVICE REAL clipped_below(REAL t) {
    return 0.5f * smooth_step(0.36440f * t + 0.50054f);
}

/* Variance of a normal number t above the place where it is clipped, in its own; within 0.022. */
DEVICE REAL clipped_variance(REAL t) {
    return smooth_step(0.40420f - 0.25427f * t);
}

/* Integral over t of what clipped_variance is below the step at t = 0, by the half of clipped_below. */
#define VARIANCE_LOST 0.75225f

/* Share of the steepest slope that saturation is met at, at least: next to a plateau it is none. */
#define SLOPE_MIN 0.3f

/* How many times the spread of the noise images are apart in E where one alone is blurred. */
#define BLUR_APART 3.0f

/* Whether pixels differ in what they make of one signal. */
#define HAS_PATTERN(d) ((d).prnu > 0.0f || (d).dsnu > 0.0f)

/* A trapezoid with the dark signal of a pixel like all. */
DEVICE Trapezoid sensed_alike(Trapezoid t, Design d) {
    t.base += d.dark_signal / d.saturation;
    return t;
}

/* And with the gain and the dark signal of a pixel of its own. */
DEVICE Trapezoid sensed(Trapezoid t, Normals pattern, Design d) {
    if (!HAS_PATTERN(d)) {
        return sensed_alike(t, d);
    }
    float shot = 1.0f / d.saturation;
    Response own = response_of(pattern, d);
    t.slope *= own.gain;
    t.base = t.base * own.gain + own.dark * shot;
    return t;
}

/* Images of a scan that lie within a distance x of a centre, 0 to 1/2. */
DEVICE REAL images_within(Trapezoid t, REAL x, float shifts) {
    return 1.0f + 2.0f * shifts * x - fraction_of((x - t.centre) * shifts)
           - fraction_of((x + t.centre) * shifts);
}

/* What a trapezoid passes on its sides. */
STRUCT(Sides) {
    REAL high; /* E up to the distance `top` from a centre */
    REAL low;  /* and from the distance `foot` on */
    REAL top;
    REAL foot;
    REAL edge; /* where it saturates */
    REAL fall; /* by how much E falls there from image to image */
};

DEVICE Sides sides_of(Trapezoid t, float step) {
    Sides s;
    REAL y = unsaturated(t);
    s.high = t.base + t.slope * t.flank;
    s.low = t.base;
    s.top = t.edge - (t.flank + t.corner);
    s.foot = t.edge;
    s.edge = t.edge - y;
    s.fall = max(t.slope * max(rising(t, y), SLOPE_MIN) * step, 1e-9f);
    if (ANY(t.overlap)) {
        REAL centre = 0.0f;
        REAL between = 0.5f;
        s.high = (t.overlap ? at_distance(t, centre) : s.high);
        s.low = (t.overlap ? at_distance(t, between) : s.low);
        MASK inner = s.edge < -s.top;
        s.top = max(s.top, 0.0f);
        MASK together = t.overlap && (s.edge + t.edge > 1.0f || inner && s.high > 1.0f);
        s.edge = (inner ? s.top : s.edge);
        if (ANY(together)) {
            s.edge = (together ? saturated_to(t) : s.edge);
        }
        s.foot = min(s.foot, 0.5f);
    }
    return s;
}

/* Excess of the image nearest to saturation on one side, `past` it by -1/2 to 1/2 of a step, in units
   of the blur and of its square; where none saturates, or all do, E is off by so many blurs. Noise
   moves the other images too little to saturate or not. */
DEVICE Excess nearest_excess(Sides s, REAL past, float step, REAL apart, REAL beyond) {
    REAL none = 0.0f;
    REAL one = 1.0f;
    REAL x = s.edge - past * step;
    REAL off = past * apart + beyond;
    MASK alone = x > s.top && x < s.foot;
    Excess e;
    e.mean = (alone ? clipped_mean(off) : none);
    e.variance = (alone ? clipped_variance(off) - (off < 0.0f ? one : none) : none);
    return e;
}

/* Mean and variance of a grey level. */
STRUCT(Moments) {
    REAL mean;     /* DN */
    REAL variance; /* DN^2 */
};

/* Those of one image, at a signal E. */
DEVICE Moments moments_at(Cells cells, Noise n, Design d, REAL signal) {
    REAL none = 0.0f;
    Excess excess = cell_excess(cells, place_of(signal));
    REAL even = n.dn * n.dn * (n.shot * signal + n.read) + 1.0f / 12.0f;
    Moments m;
    m.mean = d.black_level + n.dn * min(signal, 1.0f) + excess.mean;
    m.variance = (signal < 1.0f ? even : none) + excess.variance;
    return m;
}

/* Mean and variance of the noisy mean over a scan, over all draws of its noise: of the clipped mean,
   with the excess of the images on the plateaus and of those about to saturate. Where images are so
   near each other that noise blurs several, one alone is given as much as it can take, and the rest
   is an integral over all. */
DEVICE Moments noisy_mean_over_scan(Trapezoid t, Design d, Noise n, Cells cells) {
    REAL none = 0.0f;
    float shifts = d.distinct_shifts;
    Sides s = sides_of(t, n.step);
    REAL mean = mean_over_scan(t, shifts);
    REAL first = fraction_of((s.edge - t.centre) * shifts);
    REAL second = fraction_of((s.edge + t.centre) * shifts);
    REAL full = 1.0f + 2.0f * shifts * s.edge - first - second;
    REAL beyond = none;
    REAL bright = none;
    REAL crossed = none + 0.5f;
    Excess high = no_excess();
    if (ANY(place_of(s.high) < cells.last)) {
        high = excess_at(cells, n, s.high);
        bright = images_within(t, s.top, shifts);
        full = (saturates(s.high) ? min(full, shifts) : none);
        beyond = min(s.high - 1.0f, 0.0f);
        crossed = clipped_below((s.high - 1.0f) * n.per_spread);
    }
    REAL dark = max(shifts - images_within(t, s.foot, shifts), 0.0f);
    Excess low = excess_at(cells, n, s.low);
    if (ANY(s.low > 1.0f - 4.0f * n.spread)) {
        full = (saturates(s.low) ? none + shifts : full);
        beyond += max(s.low - 1.0f, 0.0f);
        crossed -= clipped_below((s.low - 1.0f) * n.per_spread);
    }
    REAL apart = max(s.fall * n.per_spread, BLUR_APART);
    REAL blur = min(s.fall * (1.0f / BLUR_APART), n.spread);
    REAL rest = none;
    if (ANY(blur < n.spread || beyond != 0.0f)) {
        beyond *= 1.0f / blur;
        rest = 2.0f * (n.spread - blur) * crossed / s.fall;
    }
    Excess left = nearest_excess(s, first - rint(first), n.step, apart, beyond);
    Excess right = nearest_excess(s, second - rint(second), n.step, apart, beyond);
    REAL lowered = blur * (left.mean + right.mean) + (n.spread + blur) * rest;
    REAL lost = left.variance + right.variance - rest * VARIANCE_LOST;
    REAL others = shifts - full;
    REAL sum = (mean * shifts - full) * n.shot + n.read * others + (n.shot + n.read) * lost;
    sum = n.dn * n.dn * sum + others * (1.0f / 12.0f) + bright * high.variance + dark * low.variance;
    Moments m;
    m.mean = d.black_level + n.dn * mean
             + (bright * high.mean + dark * low.mean - n.dn * lowered) * n.step;
    m.variance = max(sum, 0.0f) * (n.step / d.images);
    return m;
}

/* One draw of an aspect image whose moments are known: normal, as a sum of many images nearly is. */
DEVICE REAL one_draw(Moments m, REAL normal, float full_scale) {
    return clamp(m.mean + sqrt(m.variance) * normal, 0.0f, full_scale);
}

/* A bound of every draw of a pixel whose light coordinate is any, from the highest excess of a mean
   and the highest variance that a grey level has at any signal. */
DEVICE REAL highest_draw(Trapezoid t, Design d, float excess, float variance) {
    REAL none = 0.0f;
    Normals highest;
    highest.first = none + NORMAL_MAX;
    highest.second = highest.first;
    REAL mean = highest_mean_over_scan(sensed(t, highest, d), d.distinct_shifts);
    return d.black_level + (d.full_scale - d.black_level) * mean + excess
           + NORMAL_MAX * sqrt(none + variance / d.images);
}

#endif
