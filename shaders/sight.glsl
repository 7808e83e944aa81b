/* What a sub-ray sees, as `ray.glsl` reads it; ACROSS for a light of the user's own. */
vec4 entry_of(Sight v) {
    float last = v.lost > 0.0 ? -v.lost : v.irradiance;
#ifdef ACROSS
    return vec4(v.light, length(vec2(v.wide, v.narrow)), v.across, last);
#else
    return vec4(v.light, v.wide, v.narrow, last);
#endif
}
