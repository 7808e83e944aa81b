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
#include "pattern.glsl"

float value_at(int i, int k) {
    Ray ray = ray_at(i);
#ifdef PICTURE
    return picture(place, ray.light, ACROSS(i), ray.footprint, k);
#else
    return pattern(ray.light, ACROSS(i), shift_of(d, k) / d.periods_per_mm, ray.footprint);
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

/* Share of a pixel's samples that are NaN or outside [0, 1]; every PROBES-th image is looked at. */
#define PROBES 8
float faulty_share() {
    int images = int(d.images);
    float count = 0.0;
    for (int k = 0; k < images; k += PROBES) {
        for (int i = 0; i < sub_rays; i++) {
            float value = value_at(i, k);
            count += ray_at(i).irradiance > 0.0 && !(value >= 0.0 && value <= 1.0) ? 1.0 : 0.0;
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

/* Mean of all images; in a loop of its own where llvmpipe would mask what a pixel has not. */
float mean_of(uint column, uint row) {
#ifndef PATTERN
    if (d.noise == 0.0 && sub_rays == 1) {
        Trapezoid only = exposed_at(d, Pixels(1), 0);
        int images = int(d.images);
        float sum = 0.0;
        for (int k = 0; k < images; k++) {
            sum += min(at_shift(only, shift_of(d, k)), 1.0);
        }
        return d.full_scale * sum / float(images);
    }
#endif
    return mean_over_images(d, Pixels(sub_rays), column, row);
}
