/* A pixel's images, one after another, and what they are fused to. The including program has a
   struct `Pixels` with the number of `sub_rays`, and fetches a sub-ray's entry of the light map by
   RAY(px, i). With PATTERN the light is a user's, and `signal_of` and `signals_from` stand before
   this. */
#ifndef SCAN_H
#define SCAN_H

#ifndef PATTERN
/* Exposure of sub-ray i as a function of the shift. */
DEVICE EXPOSED exposed_at(Design d, Pixels px, int i) {
    return exposed_ray(d, RAY(px, i), px.sub_rays);
}

/* Exposure E of a pixel in image k, summed over its sub-rays. */
DEVICE REAL signal_of(Design d, Pixels px, int k) {
    REAL signal = 0.0f;
    for (int i = 0; i < px.sub_rays; i++) {
        signal += EXPOSED_AT(exposed_at(d, px, i), shift_of(d, k));
    }
    return signal;
}

/* The same in CHUNK images from image `first` on: each sub-ray's trapezoid is made once for all. */
DEVICE Signals signals_from(Design d, Pixels px, int first) {
    Signals signals;
    for (int j = 0; j < CHUNK; j++) {
        signals.value[j] = 0.0f;
    }
    for (int i = 0; i < px.sub_rays; i++) {
        EXPOSED t = exposed_at(d, px, i);
        for (int j = 0; j < CHUNK; j++) {
            signals.value[j] += EXPOSED_AT(t, shift_of(d, first + j));
        }
    }
    return signals;
}
#endif

#if !defined(PATTERN) && !defined(PROFILE)
/* Sum of min(E, 1) over the images from `first` up to `last`. */
DEVICE REAL sum_of_images(Design d, Trapezoid t, int first, int last) {
    REAL sum = 0.0f;
    for (int k = first; k < last;) {
        REAL part = 0.0f;
        for (int end = k + CHUNK < last ? k + CHUNK : last; k < end; k++) {
            part += min(at_shift(t, shift_of(d, k)), 1.0f);
        }
        sum += part;
    }
    return sum;
}

/* First image whose shift is at least `shift` periods, of those from `first` up to `last`. */
DEVICE int image_from(Design d, float shift, int first, int last) {
    float k = -floor(-shift / d.step);
    return k > FLOAT(first) ? (k < FLOAT(last) ? INT(k) : last) : first;
}

/* Mean of min(E, 1) over the images of a pixel of one ray. E changes where a side passes: up to
   `full` from a centre it is at its highest or saturates, and from the edge on at its least, the
   same in every image. Pixels of a REAL see their sides pass in nearly the same images, and all but
   those are counted. A little more than float32 may put them out is left between. Beside the image
   a shader's lanes work on what is no ray: of them too there is an end. */
DEVICE REAL mean_of_ray(Design d, Trapezoid t) {
    int images = INT(d.images);
    REAL full = t.edge - unsaturated(t);
    t.centre -= rint(t.centre - LEAST(t.centre));
    float slack = 1e-6f * (8.0f + d.images * d.step);
    float rise = LEAST(t.centre - t.edge) - slack;
    float risen_all = slack - LEAST(full - t.centre);
    float fall = LEAST(t.centre + full) - slack;
    float fallen_all = slack - LEAST(-t.centre - t.edge);
    if (ANY(t.overlap) || !(fallen_all < rise + 1.0f) || d.step > 0.5f) {
        return sum_of_images(d, t, 0, images) / d.images;
    }
    REAL sum = 0.0f;
    int bright = 0;
    int dark = 0;
    int done = 0;
    for (int turn = 0; turn <= images && done < images; turn++) {
        float period = FLOAT(turn) - floor(fallen_all);
        int begin = image_from(d, period + rise, done, images);
        int all = image_from(d, period + risen_all, begin, images);
        int end = image_from(d, period + fall, all, images);
        int none = image_from(d, period + fallen_all, end, images);
        sum += sum_of_images(d, t, begin, all) + sum_of_images(d, t, end, none);
        dark += begin - done;
        bright += end - all;
        done = none;
    }
    sum += FLOAT(bright) * min(t.base + t.slope * t.flank, 1.0f) + FLOAT(dark) * min(t.base, 1.0f);
    return sum / d.images;
}
#endif

/* Mean of all images, without holding any. */
DEVICE REAL mean_over_images(Design d, Pixels px, COUNTER column, COUNTER row) {
#if !defined(PATTERN) && !defined(PROFILE)
    if (d.noise == 0.0f && px.sub_rays == 1) {
        return d.full_scale * mean_of_ray(d, exposed_at(d, px, 0));
    }
#endif
    Normals pattern = fixed_pattern(d, column, row);
    int images = INT(d.images);
    REAL sum = 0.0f;
    for (int first = 0; first < images; first += CHUNK) {
        Signals signals = signals_from(d, px, first);
        REAL part = 0.0f;
        for (int j = 0; j < CHUNK; j++) {
            if (first + j < images) {
                part += grey_level(signals.value[j], d, first + j, column, row, pattern);
            }
        }
        sum += part;
    }
    return sum / FLOAT(images);
}

/* What the images so far are fused to, in DN. */
STRUCT(Fusion) {
    REAL mean;
    REAL high;
    REAL low;
    REAL deviation;  /* until all are there: the sum of squares of the deviations */
    REAL difference; /* until all are there: the sum */
};

/* Of no image yet. */
DEVICE Fusion fusion_of_none(Design d) {
    Fusion f;
    f.mean = 0.0f;
    f.high = 0.0f;
    f.low = d.full_scale;
    f.deviation = 0.0f;
    f.difference = 0.0f;
    return f;
}

/* With the grey level y of one more image, after k others. Deviation by Welford's update, which
   does not cancel: B. P. Welford, Technometrics 4(3), 1962. */
DEVICE Fusion with_image(Fusion f, REAL y, int k) {
    REAL gap = y - f.mean;
    f.mean += gap / FLOAT(k + 1);
    f.deviation += gap * (y - f.mean);
    f.high = max(f.high, y);
    f.low = min(f.low, y);
    return f;
}

/* Of all images: standard deviation, and the mean |y(k + m) - y(k)| of the pairs. */
DEVICE Fusion fusion_of_all(Fusion f, int images, int pairs) {
    f.deviation = sqrt(max(f.deviation / FLOAT(images), 0.0f));
    f.difference = f.difference / FLOAT(pairs > 0 ? pairs : 1);
    return f;
}

/* Every fusion in one pass. The differential's pairs wrap around where the shifts fill the period;
   else the last m images begin no pair. */
DEVICE Fusion fusion_over_images(Design d, Pixels px, COUNTER column, COUNTER row) {
    Normals pattern = fixed_pattern(d, column, row);
    int images = INT(d.images);
    int lag = INT(d.lag);
    int pairs = INT(d.pairs);
    Fusion f = fusion_of_none(d);
    for (int first = 0; first < images; first += CHUNK) {
        Signals signals = signals_from(d, px, first);
        Signals later = signals_from(d, px, first + lag);
        for (int j = 0; j < CHUNK; j++) {
            int k = first + j;
            if (k < images) {
                REAL y = grey_level(signals.value[j], d, k, column, row, pattern);
                f = with_image(f, y, k);
                if (k < pairs) {
                    int partner = (k + lag) % images;
                    REAL other = grey_level(later.value[j], d, partner, column, row, pattern);
                    f.difference += fabs(other - y);
                }
            }
        }
    }
    return fusion_of_all(f, images, pairs);
}

#endif
