/* Sinusoidal fringes of the station's period. The mean of a cosine over a box of width w is the
   cosine times sin(u)/u, u = pi w / P. */
float pattern(float light, float across, float shift, float footprint) {
    float period = 1.0 / d.periods_per_mm;
    float u = max(3.14159265 * footprint / period, 1e-4);
    float contrast = sin(u) / u;
    return 0.5 + 0.5 * contrast * cos(6.2831853 * (light - shift) / period);
}
