/* A pixel's images, one after another, and what they are fused to. The including program has a
   struct `Pixels` with the number of `sub_rays`, and fetches a sub-ray's entry of the light map by
   RAY(px, i). With PATTERN the light is a user's, and `signal_of` and `signals_from` stand before
   this. */
#ifndef SCAN_H
#define SCAN_H

#ifndef PATTERN
/* Exposure of sub-ray i as a function of the shift. */
DEVICE Trapezoid exposed_at(Design d, Pixels px, int i) {
    Ray ray = RAY(px, i);
    return exposed_ray(d, ray.light, ray.footprint, ray.irradiance, px.sub_rays);
}

/* Exposure E of a pixel in image k, summed over its sub-rays. */
DEVICE REAL signal_of(Design d, Pixels px, int k) {
    REAL signal = 0.0f;
    for (int i = 0; i < px.sub_rays; i++) {
        signal += at_shift(exposed_at(d, px, i), shift_of(d, k));
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
        Trapezoid t = exposed_at(d, px, i);
        for (int j = 0; j < CHUNK; j++) {
            signals.value[j] += at_shift(t, shift_of(d, first + j));
        }
    }
    return signals;
}
#endif

/* Mean of all images, without holding any. */
DEVICE REAL mean_over_images(Design d, Pixels px, COUNTER column, COUNTER row) {
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
