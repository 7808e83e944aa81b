/* What a compute shader needs to make images of a tile: its light map in a storage buffer. One
   invocation per pixel; `place_pixel` fills what scan.glsl asks for. Without NOISE or with ONE_RAY
   the compiler is told, or lavapipe works out every image's noise only to mask it. */
layout(local_size_x = GROUP) in;

layout(std140, set = 0, binding = 0) uniform Designs {
    Design design;
#ifdef PATTERN
    Geometry geometry; /* for the user's pattern, as `g` */
#endif
};
layout(std140, set = 0, binding = 1) uniform Call {
    ivec4 size; /* columns, rows of the tile, its first row, sub-rays */
    ivec4 more; /* number of the image, 0, columns of the image, 0 */
};
layout(std430, set = 0, binding = 2) readonly buffer Rays { vec4 rays[]; }; /* see ray.glsl */
layout(std430, set = 0, binding = 3) buffer Grey { float grey[]; };
#ifdef LISTED
layout(std430, set = 0, binding = 4) readonly buffer Pixels_ { uint pixels[]; };
#endif
#ifdef PATTERN

Geometry g;
#endif

Design d;
#ifdef ONE_RAY
const int sub_rays = 1;
#else
int sub_rays;
#endif
int at;
int plane;

vec4 entry(int i) {
    return rays[at + i * plane];
}

#include "ray.glsl"

/* The pixel of the whole image. */
uvec2 pixel() {
    uint row = gl_GlobalInvocationID.y + uint(size.z);
#ifdef LISTED
    uint number = pixels[row * uint(size.x) + gl_GlobalInvocationID.x];
    return uvec2(number % uint(more.z), number / uint(more.z));
#else
    return uvec2(gl_GlobalInvocationID.x, row);
#endif
}

void place_pixel() {
    d = design;
#ifdef PATTERN
    g = geometry;
#endif
#ifndef NOISE
    d.noise = 0.0;
#endif
#ifndef ONE_RAY
    sub_rays = size.w;
#endif
    plane = size.x * size.y;
    at = int(gl_GlobalInvocationID.y) * size.x + int(gl_GlobalInvocationID.x);
}
