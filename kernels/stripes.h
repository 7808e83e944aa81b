/* What a footprint sees of the stripes: the lit fraction, its exposure, and their mean over a
   scan. Lengths on the light are in periods P of the stripes here. */
#ifndef STRIPES_H
#define STRIPES_H

/* Least width of a footprint's narrow box, in periods: none at all, kept finite. */
#define NARROW_MIN 1e-5f

/* By more than float32 may put the edge of saturation out, in periods. */
#define EDGE_ROUNDING 1e-6f

/* At which the mean over a scan is tried for its highest. */
#define PHASES 16

/* As a function of the shift s, what a footprint sees is a periodic trapezoid with rounded corners,
   even about `centre` and falling to its sides: base + slope step(edge - d), d the distance of l - s
   from the nearest centre. */
STRUCT(Trapezoid) {
    REAL centre;  /* in [0, 1) */
    REAL edge;    /* the distance at which the least is reached */
    REAL flank;   /* M: lengths over which its sides rise */
    REAL corner;  /* m <= M: and over which they bend, at either end */
    REAL base;
    REAL slope;
    REAL bend;    /* 1/2m */
    MASK overlap; /* whether sides bend in one place: both of a stripe, or those of neighbours */
};

/* Lit fraction q at l, the stripes of width a averaged over two boxes w1 >= w2: three boxes folded,
   in any order. Of a box the whole periods give the mean. With n = floor(w), w' = w - n:
   q = [a (n2 w1 + w2' n1) + a * w1' * w2'] / (w1 w2), centres at a/2 + (n1 + n2)/2 + Z.
   Of the three the widest is the stripe, the other two, M >= m, make its sides. */
DEVICE Trapezoid lit_fraction(REAL light, REAL wide, REAL narrow, float luminous) {
    narrow = max(narrow, NARROW_MIN);
    REAL n1 = floor(wide);
    REAL n2 = floor(narrow);
    REAL rest1 = wide - n1;
    REAL rest2 = narrow - n2;
    REAL less = min(rest1, rest2);
    REAL more = max(rest1, rest2);
    REAL centre = (light - 0.5f * luminous) - 0.5f * (n1 + n2);
    Trapezoid q;
    q.centre = centre - floor(centre);
    q.corner = max(min(less, luminous), 1e-9f);
    q.flank = max(less, min(more, luminous));
    REAL sides = q.flank + q.corner;
    REAL widest = max(more, luminous);
    q.edge = 0.5f * (widest + sides);
    REAL boxes = wide * narrow;
    REAL inverse = 1.0f / (boxes * q.corner);
    REAL share = inverse * q.corner;
    q.bend = 0.5f * boxes * inverse;
    q.slope = q.corner * share;
    q.base = luminous * (n2 * wide + rest2 * n1) * share;
    q.overlap = sides > widest || q.edge > 0.5f;
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

/* How far a side has risen at y from its foot, 0 to M: a box M folded with a box m, summed up. */
DEVICE REAL risen(Trapezoid t, REAL y) {
    REAL up = clamp(y, 0.0f, t.flank + t.corner);
    REAL toe = min(up, t.corner);
    REAL shoulder = max(up - t.flank, 0.0f);
    return (up - toe) + (toe * toe - shoulder * shoulder) * t.bend;
}

/* Sides that reach a place: the stripe's own near and far side, and one of either neighbour. */
#define SIDES 4

/* Distance of the place at d from the foot of one of them. */
DEVICE REAL from_foot(Trapezoid t, REAL d, int side) {
    return t.edge + (side < 2 ? -d : d) - FLOAT(side % 2);
}

/* What they add there: no box is wider than a period, so that of the neighbour's near side no shoulder
   is within 1/2, and of both far sides no more than a bend: what one still lacks, and the other's
   toe. */
DEVICE REAL risen_of_others(Trapezoid t, REAL d) {
    REAL near = max(t.edge + d - 1.0f, 0.0f);
    REAL toe = min(near, t.corner);
    REAL lacking = max((t.flank + t.corner - t.edge) - d, 0.0f);
    REAL far = max((t.edge - 1.0f) - d, 0.0f);
    return (near - toe) + (toe * toe + far * far - lacking * lacking) * t.bend;
}

/* Value at a distance d from the nearest centre, 0 to 1/2. */
DEVICE REAL at_distance(Trapezoid t, REAL d) {
    REAL sum = risen(t, t.edge - d);
    if (ANY(t.overlap)) {
        REAL none = 0.0f;
        sum = max(sum + (t.overlap ? risen_of_others(t, d) : none), 0.0f);
    }
    return t.base + t.slope * sum;
}

/* A trapezoid's value when the light is shifted by `shift` periods. */
DEVICE REAL at_shift(Trapezoid t, float shift) {
    REAL u = t.centre - shift;
    return at_distance(t, fabs(u - rint(u)));
}

/* x - floor(x), from 0 to 1. */
DEVICE REAL fraction_of(REAL x) {
    return x - floor(x);
}

/* Change of the periodic Bernoulli polynomial B3(t) = t^3 - 3t^2/2 + t/2 from t in [0, 1) on, over a
   length; without a difference of near values, so that it may be as short as one likes. */
DEVICE REAL bernoulli_change(REAL t, REAL over) {
    REAL h = fraction_of(over);
    REAL past = max(t + h - 1.0f, 0.0f);
    REAL poly = 3.0f * t * (t - 1.0f) + (h * (3.0f * t + (h - 1.5f)) + 0.5f);
    return h * poly - 3.0f * past * past;
}

/* The same of a bent stretch that begins at the distance d, on both sides of the centre. */
DEVICE REAL bend_change(Trapezoid t, REAL d, REAL over, float shifts) {
    return bernoulli_change(fraction_of((d - t.centre) * shifts), over * shifts)
           + bernoulli_change(fraction_of((d + t.centre) * shifts), over * shifts);
}

/* B2(t) = t^2 - t + 1/6 of a kink at the distance d, on both sides of the centre. */
DEVICE REAL kink_change(Trapezoid t, REAL d, float shifts) {
    REAL a = fraction_of((d - t.centre) * shifts);
    REAL b = fraction_of((d + t.centre) * shifts);
    return a * a - a + b * b - b + 1.0f / 3.0f;
}

/* How far a side rises before it saturates, from its foot: the inverse of `risen` on toe, flank and
   shoulder; M + m where it does not. */
DEVICE REAL unsaturated(Trapezoid t) {
    REAL height = (1.0f - t.base) / max(t.slope, 1e-20f);
    REAL half_bent = 0.5f * t.corner;
    REAL beyond = t.flank - height;
    REAL y = height + half_bent;
    MASK low = height < half_bent;
    if (ANY(low)) {
        y = (low ? sqrt(max(2.0f * t.corner * height, 0.0f)) : y);
    }
    MASK high = beyond < half_bent;
    if (ANY(high)) {
        y = (high ? (t.flank + t.corner) - sqrt(max(2.0f * t.corner * beyond, 0.0f)) : y);
    }
    return y;
}

/* Mean of min(E, 1) over whole periods in equal steps, `shifts` of them a period, where each side
   saturates at y from its foot and no other side reaches there. The images are samples of a function
   whose pieces are polynomials: their mean is its integral and, at each kink, a term for the jumps of its
   slope f' and of f'', int f - sum [f'] B2/2K^2 + sum [f''] B3/6K^3 (Euler and Maclaurin), the
   argument frac(K (kink - sample)). The cost does not depend on the images' number. */
DEVICE REAL mean_of_sides(Trapezoid t, REAL y, float shifts) {
    REAL toe = min(y, t.corner);
    REAL rest = y - toe;
    REAL x = t.edge - y;
    REAL squares = toe * toe;
    REAL cubes = squares * toe;
    REAL bent = toe;
    REAL bends = -bend_change(t, t.edge - toe, toe, shifts);
    REAL shoulder = max(y - t.flank, 0.0f);
    if (ANY(shoulder > 0.0f)) {
        squares -= shoulder * shoulder;
        cubes -= shoulder * shoulder * shoulder;
        bent -= shoulder;
        bends += bend_change(t, x, shoulder, shifts);
    }
    float step = 1.0f / shifts;
    REAL area = cubes * t.bend * (1.0f / 3.0f) + 0.5f * rest * (t.corner + rest);
    REAL ripple = t.bend * (step * step)
                  * (bends * (step * (1.0f / 3.0f)) + bent * kink_change(t, x, shifts));
    return t.base + t.slope * (2.0f * (x * (rest + squares * t.bend) + area) + ripple);
}

/* Integral of a ramp that begins with a toe of length m, from 0 to y. */
DEVICE REAL under_ramp(Trapezoid t, REAL y) {
    REAL toe = clamp(y, 0.0f, t.corner);
    REAL rest = max(y - t.corner, 0.0f);
    return toe * toe * toe * t.bend * (1.0f / 3.0f) + 0.5f * rest * (t.corner + rest);
}

/* Integral of `risen` from 0 to y, and on beyond M + m. */
DEVICE REAL under_side(Trapezoid t, REAL y) {
    return under_ramp(t, y) - under_ramp(t, y - t.flank);
}

/* Slope of a side at y from its foot, as a share. */
DEVICE REAL rising(Trapezoid t, REAL y) {
    return (clamp(y, 0.0f, t.corner) - clamp(y - t.flank, 0.0f, t.corner)) * (2.0f * t.bend);
}

/* Distance from a centre up to which it saturates, whatever overlaps. Between two neighbouring ends of bends it
   is one parabola. */
DEVICE REAL saturated_to(Trapezoid t) {
    REAL from = 0.0f;
    REAL to = 0.5f;
    for (int i = 0; i < 4; i++) {
        REAL d = t.edge - (i % 2 == 1 ? t.corner : 0.0f * t.corner)
                 - (i / 2 == 1 ? t.flank : 0.0f * t.flank);
        d = fabs(d - rint(d));
        REAL over = at_distance(t, d) - 1.0f;
        from = (over >= 0.0f ? max(from, d) : from);
        to = (over < 0.0f ? min(to, d) : to);
    }
    REAL first = at_distance(t, from) - 1.0f;
    REAL last = at_distance(t, to) - 1.0f;
    REAL middle = at_distance(t, 0.5f * (from + to)) - 1.0f;
    REAL bend = 2.0f * (first + last - 2.0f * middle);
    REAL fall = first - last + bend;
    REAL root = sqrt(max(fall * fall - 4.0f * bend * first, 0.0f));
    REAL share = clamp(2.0f * first / max(fall + root, 1e-20f), 0.0f, 1.0f);
    share = (last < 0.0f ? share : 1.0f + 0.0f * share);
    return from + share * (to - from);
}

/* The mean over a scan, saturated up to x from each centre, whatever overlaps: every side counts where it is within x and 1/2. */
DEVICE REAL mean_overlapping(Trapezoid t, REAL x, float shifts) {
    REAL none = 0.0f;
    REAL area = -t.flank * (0.5f - x);
    REAL bends = 0.0f;
    REAL slope = 0.0f;
    for (int side = 0; side < SIDES; side++) {
        float down = (side < 2 ? -1.0f : 1.0f);
        area += down * (under_side(t, from_foot(t, none + 0.5f, side))
                        - under_side(t, from_foot(t, x, side)));
        slope += down * rising(t, from_foot(t, x, side));
        for (int bend = 0; bend < 2; bend++) {
            REAL foot = (bend == 0 ? none : t.flank);
            REAL end = down * (foot - from_foot(t, none, side));
            REAL other = end + down * t.corner;
            REAL first = min(end, other);
            REAL over = t.corner - max(x - first, 0.0f) - max(max(end, other) - 0.5f, 0.0f);
            first = clamp(first, x, 0.5f);
            over = clamp(over, 0.0f, 0.5f - x);
            bends += (bend == 0 ? -1.0f : 1.0f) * bend_change(t, first, over, shifts);
        }
    }
    MASK clipped = x > 0.0f && x < 0.5f;
    REAL kink = (clipped ? -slope * t.corner * kink_change(t, x, shifts) : none);
    REAL ripple = t.bend * (bends / (3.0f * shifts) + kink) / (shifts * shifts);
    return t.base + 2.0f * (x * (1.0f - t.base) + t.slope * area) + t.slope * ripple;
}

/* Mean of min(E, 1) over whole periods in equal steps, `shifts` of them a period. Sides that overlap
   add up, unless they do where E saturates. */
DEVICE REAL mean_over_scan(Trapezoid t, float shifts) {
    REAL y = unsaturated(t);
    if (ANY(t.overlap)) {
        REAL sides = t.flank + t.corner;
        REAL x = t.edge - y;
        REAL middle = 0.0f;
        MASK bright = at_distance(t, middle) > 1.0f;
        MASK inner = t.overlap && x < sides - t.edge;
        MASK together = inner && bright || t.overlap && x + t.edge > 1.0f;
        y = (inner && !bright ? sides : y);
        REAL mean = mean_of_sides(t, y, shifts);
        if (ANY(together)) {
            REAL other = mean_overlapping(t, saturated_to(t), shifts);
            mean = (together ? other : mean);
        }
        return min(mean, 1.0f);
    }
    return min(mean_of_sides(t, y, shifts), 1.0f);
}

/* A bound of the mean over a scan whose light coordinate is any: that of a trapezoid with sharp
   shoulders, which is nowhere less. As the phase moves its mean bends down only where a sample comes to
   the edge of saturation, or to its shoulder, and is highest there. */
DEVICE REAL highest_of_sharp(Trapezoid t, float shifts) {
    REAL top = min(t.base + t.slope * t.flank, 1.0f);
    REAL share = 1.0f / max(top, 1e-20f);
    t.base *= share;
    t.slope *= share;
    t.flank = 1.0f + 0.0f * top;
    REAL y = unsaturated(t);
    t.centre = t.edge - y + EDGE_ROUNDING;
    t.edge += 2.0f * EDGE_ROUNDING;
    return top * mean_of_sides(t, y, shifts);
}

/* Highest mean over a scan that any light coordinate has, or a little more. As the phase moves the
   mean can be highest where it bends down: where a sample comes to the edge of saturation, or
   smoothly where one is on a shoulder that does not saturate. Then PHASES are tried: between two of
   them, h apart, a curve lies above its chord by no more than h/4 of what its slope falls by, for each
   of the samples that may be there. */
DEVICE REAL highest_mean_over_scan(Trapezoid t, float shifts) {
    REAL y = unsaturated(t);
    REAL highest = highest_of_sharp(t, shifts);
    MASK together = t.overlap && t.edge - y + t.edge > 1.0f;
    MASK rounded = y > t.flank;
    Trapezoid moved = t;
    if (ANY(together)) {
        REAL x = saturated_to(t);
        rounded = (together ? x < t.edge - t.flank : rounded);
        moved.centre = x + EDGE_ROUNDING;
        moved.edge += 2.0f * EDGE_ROUNDING;
        REAL other = mean_over_scan(moved, shifts) + 2.0f * EDGE_ROUNDING * t.slope;
        highest = (together ? other : highest);
        moved = t;
    }
    if (ANY(rounded)) {
        REAL tried = 0.0f;
        for (int i = 0; i <= PHASES / 2; i++) {
            moved.centre = FLOAT(i) / (FLOAT(PHASES) * shifts) + 0.0f * t.centre;
            tried = max(tried, mean_over_scan(moved, shifts));
        }
        REAL samples = 2.0f * (t.corner * shifts + 1.1f);
        tried += samples / shifts * t.slope / (4.0f * FLOAT(PHASES) * shifts);
        highest = (rounded ? (together ? tried : min(tried, highest)) : highest);
    }
    return min(highest, 1.0f);
}

#endif
