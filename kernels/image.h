/* From a light map's entry to a grey level: a design's light, exposure and sensor applied. */
#ifndef IMAGE_H
#define IMAGE_H

#include "light_map.h"

/* Exposure E of a pixel in CHUNK images. */
STRUCT(Signals) {
    REAL value[CHUNK];
};

#ifdef PROFILE
#include "profile.h"

#define EXPOSED Wave
#define EXPOSED_AT(t, shift) wave_at(t, shift)

/* Exposure of one of `sub_rays` sub-rays as a function of the shift; they add up to the pixel's. What
   the part scatters is the same at every shift. */
DEVICE Wave exposed_ray(Design d, Ray ray, int sub_rays) {
    Wave w = wave_seen(d, ray.light * d.periods_per_mm, ray.wide * d.periods_per_mm,
                       ray.narrow * d.periods_per_mm);
    w = exposed_wave(w, ray.irradiance, d.exposure / FLOAT(sub_rays), d.dark_leak);
    w.base += d.exposure / FLOAT(sub_rays) * ray.irradiance * d.diffuse;
    return w;
}
#else
#define EXPOSED Trapezoid
#define EXPOSED_AT(t, shift) at_shift(t, shift)

/* Exposure of one of `sub_rays` sub-rays as a trapezoid in the shift; they add up to the pixel's.
   What the part scatters is the same at every shift. */
DEVICE Trapezoid exposed_ray(Design d, Ray ray, int sub_rays) {
    Trapezoid q = lit_fraction(ray.light * d.periods_per_mm, ray.wide * d.periods_per_mm,
                               ray.narrow * d.periods_per_mm, d.luminous_share);
    Trapezoid t = exposed(q, ray.irradiance, d.exposure / FLOAT(sub_rays), d.dark_leak);
    t.base += d.exposure / FLOAT(sub_rays) * ray.irradiance * d.diffuse;
    return t;
}
#endif

/* Exposure of one of `sub_rays` sub-rays that sees the mean radiance `lit`, 0 to 1. */
DEVICE REAL exposure_of(Design d, REAL lit, REAL irradiance, int sub_rays) {
    return d.exposure / FLOAT(sub_rays) * irradiance
           * (d.dark_leak + (1.0f - d.dark_leak) * lit + d.diffuse);
}

/* Shift of the tunnel in image k, in periods. */
DEVICE float shift_of(Design d, int k) {
    return FLOAT(k) * d.step;
}

/* Random words of a pixel in image k; column and row count over the whole image, so that noise
   does not depend on tiles. */
DEVICE Words words_of(Design d, COUNTER column, COUNTER row, uint k) {
    COUNTER seed = UINT(d.seed_low) + 65536u * UINT(d.seed_high);
    COUNTER image = k;
    return random_words(column, row, image, seed);
}

/* The fixed pattern of a pixel: its share of PRNU and DSNU, the same in every image. */
DEVICE Normals fixed_pattern(Design d, COUNTER column, COUNTER row) {
    Normals none;
    none.first = 0.0f;
    none.second = 0.0f;
    if (d.noise == 0.0f || (d.dsnu == 0.0f && d.prnu == 0.0f)) {
        return none;
    }
    Words words = words_of(d, column, row, FIXED_PATTERN);
    return normal_numbers(words.a, words.b);
}

/* The normal number of a pixel that stands for the noise of its whole sequence. */
DEVICE REAL normal_of(Design d, COUNTER column, COUNTER row) {
    Words words = words_of(d, column, row, ONE_DRAW);
    return normal_numbers(words.a, words.b).first;
}

/* Grey level of a pixel in image k, from its exposure E. */
DEVICE REAL grey_level(REAL signal, Design d, int k, COUNTER column, COUNTER row, Normals pattern) {
    if (d.noise == 0.0f) {
        return saturated(signal, d.full_scale);
    }
    Words words = words_of(d, column, row, UINT(k));
    return noisy_grey_level(signal, pattern, words, d);
}

#endif
