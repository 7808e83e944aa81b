/* A tile's light map and the design that is applied to it. */
#include "texels.glsl"

uniform sampler2D rays; /* see ray.glsl */
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

#include "ray.glsl"
