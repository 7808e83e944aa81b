/* A tile's light map and the design that is applied to it. */
#include "texels.glsl"

uniform sampler2D rays; /* light, footprint, irradiance, lost (for patterns: across) */
layout(std140) uniform Block {
    Design given;
#ifdef PATTERN
    Geometry geometry; /* for the user's pattern, as `g` */
#endif
};

Design d;
#ifdef PATTERN
Geometry g;
#endif

/* The design; where it has no noise the compiler is told, or llvmpipe works out the noise of
   every image only to mask it. */
Design design() {
    Design all = given;
#ifndef NOISE
    all.noise = 0.0;
#endif
    return all;
}

vec4 entry(int i) {
    return texelFetch(rays, texel() + ivec2(0, i * rows * WRAPS), 0);
}

Ray ray_at(int i) {
    vec4 ray = entry(i);
    return Ray(ray.x, ray.y, ray.z);
}
#define ACROSS(i) entry(i).w
