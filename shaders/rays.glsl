/* A tile's light map and the design that is applied to it. */
#include "texels.glsl"

uniform sampler2D rays; /* light, footprint, irradiance, lost */
layout(std140) uniform Block {
    Design given;
};

Design d;

/* The design; where it has no noise the compiler is told, or llvmpipe works out the noise of
   every image only to mask it. */
Design design() {
    Design all = given;
#ifndef NOISE
    all.noise.x = 0.0;
#endif
    return all;
}

vec4 entry(int i) {
    return texelFetch(rays, texel() + ivec2(0, i * rows * WRAPS), 0);
}
#define RAY(i) entry(i).xyz
