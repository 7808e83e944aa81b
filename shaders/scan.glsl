/* What becomes of the light map: one image, the running mean and the other fusions, the closed
   form. The including shader says how a sub-ray is fetched, RAY(i) = (light, footprint, irradiance),
   and has `d` (Design), `sub_rays`, and the pixel's column and row in the whole image.
   The plumbing of `kernels/sequence.cl` and `aspect.cl`, in GLSL. */

Trapezoid seen_by(vec3 ray) {
    return exposed_ray(d, ray.x, ray.y, ray.z, sub_rays);
}

/* Exposure of image k, summed over sub-rays; `first` is the first sub-ray's trapezoid. */
float signal_at(Trapezoid first, int k) {
    float signal = at_shift(first, shift_of(d, k));
    for (int i = 1; i < sub_rays; i++) {
        signal += at_shift(seen_by(RAY(i)), shift_of(d, k));
    }
    return signal;
}

/* Images whose exposure is worked out together: each sub-ray's trapezoid is made once for all. */
#define CHUNK 8

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

float mean_of_images(uint column, uint row) {
    Normals pattern = fixed_pattern(d, column, row);
    int images = int(d.sequence.x);
    float sum = 0.0;
    if (d.noise.x == 0.0 && sub_rays == 1) {
        Trapezoid only = seen_by(RAY(0));
        for (int k = 0; k < images; k++) {
            sum += min(at_shift(only, shift_of(d, k)), 1.0);
        }
        return d.sensor.y * sum / float(images);
    }
    for (int begin = 0; begin < images; begin += CHUNK) {
        float signal[CHUNK];
        exposures(begin, signal);
        for (int j = 0; j < CHUNK; j++) {
            if (begin + j < images) {
                sum += grey_level(signal[j], d, begin + j, column, row, pattern);
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
    Normals pattern = fixed_pattern(d, column, row);
    int images = int(d.sequence.x);
    int lag = int(d.sequence.w);
    int pairs = int(d.noise.w);
    Fused f = Fused(0.0, 0.0, d.sensor.y, 0.0, 0.0);
    for (int begin = 0; begin < images; begin += CHUNK) {
        float signal[CHUNK];
        float later[CHUNK];
        exposures(begin, signal);
        exposures(begin + lag, later);
        for (int j = 0; j < CHUNK; j++) {
            int k = begin + j;
            if (k < images) {
                float y = grey_level(signal[j], d, k, column, row, pattern);
                float gap = y - f.mean;
                f.mean += gap / float(k + 1);
                f.deviation += gap * (y - f.mean);
                f.high = max(f.high, y);
                f.low = min(f.low, y);
                if (k < pairs) {
                    int partner = (k + lag) % images;
                    f.difference += abs(grey_level(later[j], d, partner, column, row, pattern) - y);
                }
            }
        }
    }
    f.deviation = sqrt(max(f.deviation / float(images), 0.0));
    f.difference /= float(max(pairs, 1));
    return f;
}
