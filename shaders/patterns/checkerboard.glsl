/* A checkerboard in light coordinate and the tunnel's other coordinate: its squares scan along x and
   also break the light up across, so that scratches along x show. */
float share(float place, float footprint, float period) {
    return at_shift(lit_fraction(place / period, footprint / period, 0.5), 0.0);
}

float pattern(float light, float across, float shift, float footprint) {
    float period = 1.0 / d.periods_per_mm;
    float a = share(light - shift, footprint, period);
    float b = share(across, footprint, period);
    return a * b + (1.0 - a) * (1.0 - b);
}
