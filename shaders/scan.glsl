/* A pixel's images in GLSL: what `kernels/scan.h` makes of stripes, and a light of the user's own in
   their place. The including shader has `d` (Design) and `sub_rays`, and fetches a sub-ray by
   ray_at(i), the other coordinate of its light point by ACROSS(i). */
struct Pixels {
    int sub_rays;
};

#define RAY(px, i) ray_at(i)

#ifdef PATTERN
/* A light of the user's own (PICTURE: the whole image of the user's own); `place` is the pixel's
   (column, row). */
vec2 place;

/* Lit fraction of one box, for patterns. */
Trapezoid lit_fraction(float light, float footprint, float luminous) {
    return lit_fraction(light, footprint, 0.0, luminous);
}
#include "pattern.glsl"

float value_at(int i, int k) {
    Ray ray = ray_at(i);
#ifdef PICTURE
    return picture(place, ray.light, ACROSS(i), ray.wide, k);
#else
    return pattern(ray.light, ACROSS(i), shift_of(d, k) / d.periods_per_mm, ray.wide);
#endif
}

/* Within [0, 1]: NaN is 0, what is beyond a bound is the bound. */
float bounded(float value) {
    return value >= 0.0 ? min(value, 1.0) : 0.0;
}

float signal_of(Design design, Pixels px, int k) {
    float signal = 0.0;
    for (int i = 0; i < px.sub_rays; i++) {
        float irradiance = ray_at(i).irradiance;
        float value = bounded(value_at(i, k));
#ifdef PICTURE
        signal += irradiance > 0.0 ? value / float(px.sub_rays) : 0.0;
#else
        signal += exposure_of(design, value, irradiance, px.sub_rays);
#endif
    }
    return signal;
}

Signals signals_from(Design design, Pixels px, int first) {
    Signals signals;
    for (int j = 0; j < CHUNK; j++) {
        signals.value[j] = signal_of(design, px, first + j);
    }
    return signals;
}

/* Share of a pixel's samples that are NaN or, by more than a few roundings, outside [0, 1]; every
   PROBES-th image is looked at. */
#define PROBES 8
#define ROUNDINGS 1e-6
float faulty_share() {
    int images = int(d.images);
    float count = 0.0;
    for (int k = 0; k < images; k += PROBES) {
        for (int i = 0; i < sub_rays; i++) {
            float value = value_at(i, k);
            bool within = value >= -ROUNDINGS && value <= 1.0 + ROUNDINGS;
            count += ray_at(i).irradiance > 0.0 && !within ? 1.0 : 0.0;
        }
    }
    return count / float((images + PROBES - 1) / PROBES * sub_rays);
}
#endif

#include "scan.h"

/* Image k, in grey levels. */
float image_of(uint column, uint row, int k) {
    float signal = signal_of(d, Pixels(sub_rays), k);
    return grey_level(signal, d, k, column, row, fixed_pattern(d, column, row));
}

/* Mean of all images. */
float mean_of(uint column, uint row) {
    return mean_over_images(d, Pixels(sub_rays), column, row);
}
