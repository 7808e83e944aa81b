/* What a footprint sees of a light whose luminance over a period is a sum of harmonics, such as a
   screen's. Lengths on the light are in periods P here. */
#ifndef PROFILE_H
#define PROFILE_H

/* The harmonics of a design as lists, which a loop goes through. */
STRUCT(Harmonics) {
    float cosine[HARMONICS];
    float sine[HARMONICS];
};

DEVICE Harmonics harmonics_of(Design d) {
    Harmonics p;
    p.cosine[0] = d.cosine_1;
    p.sine[0] = d.sine_1;
    p.cosine[1] = d.cosine_2;
    p.sine[1] = d.sine_2;
    p.cosine[2] = d.cosine_3;
    p.sine[2] = d.sine_3;
    p.cosine[3] = d.cosine_4;
    p.sine[3] = d.sine_4;
    p.cosine[4] = d.cosine_5;
    p.sine[4] = d.sine_5;
    p.cosine[5] = d.cosine_6;
    p.sine[5] = d.sine_6;
    p.cosine[6] = d.cosine_7;
    p.sine[6] = d.sine_7;
    p.cosine[7] = d.cosine_8;
    p.sine[7] = d.sine_8;
    p.cosine[8] = d.cosine_9;
    p.sine[8] = d.sine_9;
    p.cosine[9] = d.cosine_10;
    p.sine[9] = d.sine_10;
    p.cosine[10] = d.cosine_11;
    p.sine[10] = d.sine_11;
    p.cosine[11] = d.cosine_12;
    p.sine[11] = d.sine_12;
    p.cosine[12] = d.cosine_13;
    p.sine[12] = d.sine_13;
    p.cosine[13] = d.cosine_14;
    p.sine[13] = d.sine_14;
    p.cosine[14] = d.cosine_15;
    p.sine[14] = d.sine_15;
    p.cosine[15] = d.cosine_16;
    p.sine[15] = d.sine_16;
    return p;
}

/* Exposure as a function of the shift s: base + slope L(l - s), with the luminance that the footprint
   sees L(u) = mean + sum of cosine_h cos(2 pi h u) + sine_h sin(2 pi h u), kept within 0 and 1. */
STRUCT(Wave) {
    REAL light; /* l, in [0, 1) */
    REAL base;
    REAL slope;
    float mean;
    int harmonics;
    REAL cosine[HARMONICS];
    REAL sine[HARMONICS];
};

/* sin(pi x) / (pi x): by what a box of x periods of a harmonic weakens it. */
DEVICE REAL weakened(REAL x) {
    REAL half_turns = x - 2.0f * rint(0.5f * x);
    REAL angle = 3.14159265f * half_turns;
    REAL square = angle * angle;
    REAL series = 1.0f - square * (1.0f / 6.0f) * (1.0f - square * 0.05f);
    MASK small = fabs(x) < 0.1f;
    REAL far = sin(angle) / (3.14159265f * max(x, 0.1f));
    return small ? series : far;
}

/* The light seen at l through two boxes: each harmonic weakened by both. */
DEVICE Wave wave_seen(Design d, REAL light, REAL wide, REAL narrow) {
    Harmonics p = harmonics_of(d);
    Wave w;
    w.light = light - floor(light);
    w.base = 0.0f;
    w.slope = 1.0f;
    w.mean = d.mean_luminance;
    w.harmonics = INT(d.harmonics);
    for (int h = 0; h < w.harmonics; h++) {
        float order = FLOAT(h + 1);
        REAL share = weakened(order * wide) * weakened(order * narrow);
        w.cosine[h] = p.cosine[h] * share;
        w.sine[h] = p.sine[h] * share;
    }
    return w;
}

/* Signal over saturation before the sensor clips, E = g rho V (beta + (1 - beta) L). */
DEVICE Wave exposed_wave(Wave w, REAL irradiance, float gain, float leak) {
    REAL full = gain * irradiance;
    w.base = full * leak;
    w.slope = full * (1.0f - leak);
    return w;
}

/* Its value when the light is shifted by `shift` periods; each harmonic turns on from the one before. */
DEVICE REAL wave_at(Wave w, float shift) {
    REAL turn = w.light - shift;
    REAL angle = 6.2831853f * (turn - rint(turn));
    REAL cosine = cos(angle);
    REAL sine = sin(angle);
    REAL even = cosine;
    REAL odd = sine;
    REAL sum = w.mean;
    for (int h = 0; h < w.harmonics; h++) {
        sum += w.cosine[h] * even + w.sine[h] * odd;
        REAL turned = even * cosine - odd * sine;
        odd = odd * cosine + even * sine;
        even = turned;
    }
    return w.base + w.slope * clamp(sum, 0.0f, 1.0f);
}

#endif
