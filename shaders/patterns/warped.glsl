/* Stripes warped to a crowned part, so that the camera sees them evenly spaced.

   A flat ceiling at H over a crown of curvature c, camera at h: the point x of the part sees
   l(x) = x + H tan(atan(x/h) + 2 asin(c x)). Inverted by Newton's method, each stripe covers the same
   length of the part; `period` is then on the part. */
float light_of(float x) {
    float c = g.part.z;
    return x + g.tunnel.y * tan(atan(x / g.camera.x) + 2.0 * asin(clamp(c * x, -0.5, 0.5)));
}

float pattern(float light, float across, float shift, float footprint) {
    float x = light / (1.0 + g.tunnel.y / g.camera.x);
    float slope = 1.0;
    for (int i = 0; i < 8; i++) {
        slope = (light_of(x + 0.01) - light_of(x - 0.01)) / 0.02;
        x -= (light_of(x) - light) / slope;
    }
    float period = 1.0 / (d.stripes.y * (1.0 + g.tunnel.y / g.camera.x));
    Trapezoid lit = lit_fraction(x / period, footprint / slope / period, d.stripes.x);
    return at_shift(lit, shift * d.stripes.y);
}
