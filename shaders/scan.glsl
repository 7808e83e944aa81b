/* What becomes of the light map: one image, the running mean and the other fusions, the closed
   form. The including shader says how a sub-ray is fetched, RAY(i) = (light, footprint, irradiance),
   and has `d` (Design), `sub_rays`, and the pixel's column and row in the whole image.
   The plumbing of `kernels/sequence.cl` and `aspect.cl`, in GLSL. */

/* Images whose exposure is worked out together: each sub-ray's trapezoid is made once for all. */
#define CHUNK 8

#ifdef PATTERN
/* A light of the user's own (PICTURE: the whole image of the user's own). RAY4(i) has the other
   coordinate of the light point in w; `place` is the pixel's (column, row). */
vec2 place;
#include "pattern.glsl"

float value_at(vec4 ray, int k) {
#ifdef PICTURE
    return picture(place, ray.x, ray.w, ray.y, k);
#else
    return pattern(ray.x, ray.w, shift_of(d, k) / d.periods_per_mm, ray.y);
#endif
}

/* Within [0, 1]: NaN is 0, what is beyond a bound is the bound. */
float bounded(float value) {
    return value >= 0.0 ? min(value, 1.0) : 0.0;
}

float signal_of(int k) {
    float signal = 0.0;
    for (int i = 0; i < sub_rays; i++) {
        vec4 ray = RAY4(i);
        float value = bounded(value_at(ray, k));
#ifdef PICTURE
        signal += ray.z > 0.0 ? value / float(sub_rays) : 0.0;
#else
        signal += exposure_of(d, value, ray.z, sub_rays);
#endif
    }
    return signal;
}

void exposures(int begin, out float signal[CHUNK]) {
    for (int j = 0; j < CHUNK; j++) {
        signal[j] = signal_of(begin + j);
    }
}

/* Share of a pixel's samples that are NaN or outside [0, 1]; every PROBES-th image is looked at. */
#define PROBES 8
float faulty_share() {
    int images = int(d.images);
    float count = 0.0;
    for (int k = 0; k < images; k += PROBES) {
        for (int i = 0; i < sub_rays; i++) {
            vec4 ray = RAY4(i);
            float value = value_at(ray, k);
            count += ray.z > 0.0 && !(value >= 0.0 && value <= 1.0) ? 1.0 : 0.0;
        }
    }
    return count / float((images + PROBES - 1) / PROBES * sub_rays);
}
#else
Trapezoid seen_by(vec3 ray) {
    return exposed_ray(d, ray.x, ray.y, ray.z, sub_rays);
}

/* Exposure of image k, summed over sub-rays. */
float signal_of(int k) {
    float signal = 0.0;
    for (int i = 0; i < sub_rays; i++) {
        signal += at_shift(seen_by(RAY(i)), shift_of(d, k));
    }
    return signal;
}

/* Exposure of CHUNK images from image `begin` on, summed over sub-rays. */
void exposures(int begin, out float signal[CHUNK]) {
    for (int j = 0; j < CHUNK; j++) {
        signal[j] = 0.0;
    }
    for (int i = 0; i < sub_rays; i++) {
        Trapezoid t = seen_by(RAY(i));
        for (int j = 0; j < CHUNK; j++) {
            signal[j] += at_shift(t, shift_of(d, begin + j));
        }
    }
}
#endif

float mean_of_images(uint column, uint row) {
    Normals fixed_ = fixed_pattern(d, column, row);
    int images = int(d.images);
    float sum = 0.0;
#ifndef PATTERN
    if (d.noise == 0.0 && sub_rays == 1) {
        Trapezoid only = seen_by(RAY(0));
        for (int k = 0; k < images; k++) {
            sum += min(at_shift(only, shift_of(d, k)), 1.0);
        }
        return d.full_scale * sum / float(images);
    }
#endif
    for (int begin = 0; begin < images; begin += CHUNK) {
        float signal[CHUNK];
        exposures(begin, signal);
        for (int j = 0; j < CHUNK; j++) {
            if (begin + j < images) {
                sum += grey_level(signal[j], d, begin + j, column, row, fixed_);
            }
        }
    }
    return sum / float(images);
}

struct Fused {
    float mean;
    float high;
    float low;
    float deviation;
    float difference;
};

Fused fuse_images(uint column, uint row) {
    Normals fixed_ = fixed_pattern(d, column, row);
    int images = int(d.images);
    int lag = int(d.lag);
    int pairs = int(d.pairs);
    Fused f = Fused(0.0, 0.0, d.full_scale, 0.0, 0.0);
    for (int begin = 0; begin < images; begin += CHUNK) {
        float signal[CHUNK];
        float later[CHUNK];
        exposures(begin, signal);
        exposures(begin + lag, later);
        for (int j = 0; j < CHUNK; j++) {
            int k = begin + j;
            if (k < images) {
                float y = grey_level(signal[j], d, k, column, row, fixed_);
                float gap = y - f.mean;
                f.mean += gap / float(k + 1);
                f.deviation += gap * (y - f.mean);
                f.high = max(f.high, y);
                f.low = min(f.low, y);
                if (k < pairs) {
                    int partner = (k + lag) % images;
                    f.difference += abs(grey_level(later[j], d, partner, column, row, fixed_) - y);
                }
            }
        }
    }
    f.deviation = sqrt(max(f.deviation / float(images), 0.0));
    f.difference /= float(max(pairs, 1));
    return f;
}
