/* Stripes warped to a crowned part, so that the camera sees them evenly spaced.

   A flat ceiling at H over a crown of curvature c, camera at h: the point x of the part sees
   l(x) = x + H tan(atan(x/h) + 2 asin(c x)), written with tan(a + b) = (tan a + tan b) /
   (1 - tan a tan b), for this runs for every ray and shift. Inverted by Newton's method, each stripe
   covers the same length of the part; `period` is then on the part. */
float pattern(float light, float across, float shift, float footprint) {
    float c = g.curvature_x;
    float h = g.camera_height;
    float H = g.tunnel_top;
    float x = light / (1.0 + H / h + 2.0 * c * H);
    float slope = 1.0;
    for (int i = 0; i < 3; i++) {
        float s = clamp(c * x, -0.5, 0.5);
        float cosine = sqrt(1.0 - s * s);
        float turned = 2.0 * s * cosine / (1.0 - 2.0 * s * s);
        float view = x / h;
        float tangent = (view + turned) / (1.0 - view * turned);
        slope = 1.0 + H * (1.0 + tangent * tangent) * (1.0 / (h * (1.0 + view * view)) + 2.0 * c / cosine);
        x -= (x + H * tangent - light) / slope;
    }
    float period = 1.0 / (d.periods_per_mm * (1.0 + H / h));
    Trapezoid lit = lit_fraction(x / period, footprint / slope / period, d.luminous_share);
    return at_shift(lit, shift * d.periods_per_mm);
}
