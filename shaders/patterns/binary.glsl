/* The binary stripes themselves, seen through one box: where a footprint is one, on a flat part
   through a pinhole, they agree with the station's own to the last bits.

   pattern() is the light's radiance, 0 to 1, averaged over what a sub-ray sees of it:
   light      coordinate along the part's x axis, mm
   across     the tunnel's other coordinate, mm
   shift      how far the tunnel has moved, mm
   footprint  width of the box on the light over which the sub-ray averages, mm */
float pattern(float light, float across, float shift, float footprint) {
    float period = 1.0 / d.periods_per_mm;
    Trapezoid lit = lit_fraction(light / period, footprint / period, d.luminous_share);
    return at_shift(lit, shift / period);
}
