/* The sensor, in the words of EMVA 1288, and random numbers that belong to a pixel. */
#ifndef SENSOR_H
#define SENSOR_H

/* Below this mean, Poisson numbers are exact (inversion of the distribution function with
   POISSON_TERMS terms); above it they are Gaussian of the same mean and variance, rounded. */
#define POISSON_EXACT 16.0f
#define POISSON_TERMS 44

/* Image number of the maps that do not change from image to image (PRNU, DSNU). */
#define FIXED_PATTERN 0xffffffffu

/* And of the normal numbers that stand for the noise of a whole sequence. */
#define ONE_DRAW 0xfffffffeu

STRUCT(Words) {
    COUNTER a;
    COUNTER b;
    COUNTER c;
    COUNTER d;
};

/* pcg4d: four random words from a counter of four, with 32-bit operations only.
   M. Jarzynski, M. Olano, Hash functions for GPU rendering, JCGT 9(3), 2020. */
DEVICE Words random_words(COUNTER column, COUNTER row, COUNTER image, COUNTER seed) {
    Words v;
    v.a = column * 1664525u + 1013904223u;
    v.b = row * 1664525u + 1013904223u;
    v.c = image * 1664525u + 1013904223u;
    v.d = seed * 1664525u + 1013904223u;
    v.a += v.b * v.d;
    v.b += v.c * v.a;
    v.c += v.a * v.b;
    v.d += v.b * v.c;
    v.a ^= v.a >> 16u;
    v.b ^= v.b >> 16u;
    v.c ^= v.c >> 16u;
    v.d ^= v.d >> 16u;
    v.a += v.b * v.d;
    v.b += v.c * v.a;
    v.c += v.a * v.b;
    v.d += v.b * v.c;
    return v;
}

/* Uniform in (0, 1), ends excluded: the 23 high bits, in the middle of their step. */
DEVICE REAL uniform_number(COUNTER word) {
    return (TO_REAL(word >> 9u) + 0.5f) * 1.1920929e-7f;
}

/* Two independent standard normal numbers (Box and Muller, 1958). */
STRUCT(Normals) {
    REAL first;
    REAL second;
};

DEVICE Normals normal_numbers(COUNTER word, COUNTER other) {
    REAL radius = sqrt(-2.0f * log(uniform_number(word)));
    REAL angle = 6.2831853f * uniform_number(other);
    Normals n;
    n.first = radius * cos(angle);
    n.second = radius * sin(angle);
    return n;
}

/* Poisson number of mean mu, from a uniform and a normal number; bounded work. */
DEVICE REAL poisson_number(REAL mu, REAL uniform_, REAL normal) {
    /* Rounding adds a variance of 1/12. */
    REAL many = max(floor(mu + sqrt(max(mu - 0.083333333f, 0.0f)) * normal + 0.5f), 0.0f);
    MASK few = mu < POISSON_EXACT;
    if (!ANY(few && mu > 0.0f)) {
        return many;
    }
    REAL term = exp(-min(mu, POISSON_EXACT));
    REAL sum = term;
    REAL count = 0.0f;
    for (int i = 1; i <= POISSON_TERMS; i++) {
        /* Terms below half a last bit do not add to the sum, which may stay short of `uniform_`. */
        count += (uniform_ > sum && term > 2.9802322e-8f ? 1.0f : 0.0f);
        term *= mu / FLOAT(i);
        sum += term;
    }
    return few ? count : many;
}

/* Noise-free grey level: y = full scale x min(E, 1). */
DEVICE REAL saturated(REAL signal, float full_scale) {
    return full_scale * min(signal, 1.0f);
}

/* A pixel's own gain, and its dark signal in electrons, the same in every image. */
STRUCT(Response) {
    REAL gain;
    REAL dark;
};

DEVICE Response response_of(Normals pattern, Design d) {
    Response r;
    r.gain = max(1.0f + d.prnu * pattern.first, 0.0f);
    r.dark = max(d.dark_signal + d.dsnu * pattern.second, 0.0f);
    return r;
}

/* Grey level of one pixel of one image with noise: electrons n ~ Poisson(mu_sat E + dark), plus
   N(0, sigma_d), clipped at saturation; y = clip(round(K n + black level), 0, full scale), quantised
   once. PRNU and DSNU scale and shift each pixel the same way in every image. */
DEVICE REAL noisy_grey_level(REAL signal, Normals pattern, Words words, Design d) {
    Response own = response_of(pattern, d);
    REAL mu = d.saturation * signal * own.gain + own.dark;
    Normals normal = normal_numbers(words.b, words.c);
    REAL electrons = poisson_number(mu, uniform_number(words.a), normal.first)
                     + d.read_noise * normal.second;
    float gain = (d.full_scale - d.black_level) / d.saturation;
    return clamp(rint(gain * min(electrons, d.saturation) + d.black_level), 0.0f, d.full_scale);
}

#endif
